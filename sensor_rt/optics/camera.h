// Camera of the profile sensor: thin lens with Brown-Conrady distortion before a sensor that may be tilted.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <string>

#include "sensor_rt/geometry/rigid3.h"

namespace sensor_rt {

/// One camera. Camera frame: +z forward, x to the right (columns), y down (rows); integer pixel = pixel
/// centre.
struct Camera {
  std::string name;
  int side = 1;           ///< +1: camera at sensor X = +baseline, -1: its mirror image
  double baseline = 0.0;  ///< a: distance from the laser sheet, m
  double height = 0.0;    ///< b: sensor Z of the optical centre, m
  double tilt = 0.0;      ///< phi: angle of the optical axis from sensor Z towards the sheet, rad
  int width_px = 0;
  int height_px = 0;
  double focal_px = 0.0;
  double cx_px = 0.0;
  double cy_px = 0.0;
  std::array<double, 5> distortion{};  ///< k1, k2, p1, p2, k3 (OpenCV order)
  double f_number = 0.0;               ///< working f-number: image distance over diameter of the aperture
  double pixel_pitch = 0.0;            ///< m
  double transmission = 0.0;           ///< lens times band-pass filter, 0..1
  double focus = 0.0;         ///< what is sharp on the axis: distance from the lens, m; 0: everything is
  double psf_sigma_px = 0.0;  ///< standard deviation of the image of a point in focus
  Rigid3 sensor_from_camera;  ///< follows from side, baseline, height, tilt and the three below
  double offset_y = 0.0;      ///< of the optical centre from the plane of symmetry Y = 0, m
  double pan = 0.0;           ///< turn about camera y, rad
  double roll = 0.0;          ///< turn about camera z before that, rad

  bool is_distorted() const { return distortion != std::array<double, 5>{}; }
  bool is_tilted() const { return !tilted_from_plane_.isIdentity(0.0); }
  /// Neither distorted nor tilted: straight from directions to pixels.
  bool is_plain() const { return !is_distorted() && !is_tilted(); }
  /// Stands as the paper's formulas want it.
  bool is_aligned() const { return offset_y == 0.0 && pan == 0.0 && roll == 0.0; }
  bool has_depth_of_field() const { return focus > 0.0; }

  /// Scheimpflug: turns the image sensor about camera x, then y, where the axis meets it; OpenCV's tau_x and
  /// tau_y.
  void tilt_sensor(double about_x, double about_y);

  double image_distance() const { return focal_px * pixel_pitch; }
  double aperture_radius() const { return 0.5 * image_distance() / f_number; }

  /// Inverse depth, 1/m, at which the direction (x, y, 1) is in focus. A thin lens maps the plane of the
  /// image sensor to a plane of sharp points, so that this is linear in x and y: 1/focus on the axis, and
  /// less where the sensor leans away (Scheimpflug).
  double vergence(double x, double y) const {
    return 1.0 / focus - (lean_[0] * x + lean_[1] * y) / image_distance();
  }

  /// Pixel of a point in the camera frame by light through one point of the lens, `lens` (m) off its middle.
  Eigen::Vector2d project_through(const Eigen::Vector2d& lens, const Eigen::Vector3d& point_in_camera) const;

  /// Largest distance in pixels between the images of a point by light through the middle of the lens and
  /// through its rim, m; an upper bound.
  double blur_radius_px(const Eigen::Vector3d& point_in_camera) const;

  /// Area on the plane across the axis that a pixel of the tilted sensor stands for, over that of a pixel.
  double tilt_area(const Eigen::Vector2d& pixel) const;

  /// Pixel (column, row) of a point in the camera frame (z > 0), distortion applied.
  Eigen::Vector2d project(const Eigen::Vector3d& point_in_camera) const;

  /// Direction (x, y, 1) in the camera frame seen by pixel (column, row), distortion removed.
  Eigen::Vector3d ray(const Eigen::Vector2d& pixel) const;

  /// d (x, y) / d (column, row) of `ray` at the direction (x, y, 1).
  Eigen::Matrix2d ray_jacobian(const Eigen::Vector3d& direction) const;

  /// The paper's p = (p_x along sensor +Y, p_y towards larger range), px from the principal point,
  /// undistorted.
  Eigen::Vector2d paper_coordinates(const Eigen::Vector2d& pixel) const;

 private:
  Eigen::Vector2d tilted(const Eigen::Vector2d& on_plane) const;
  Eigen::Vector2d untilted(const Eigen::Vector2d& on_sensor) const;

  // Between the plane across the axis at distance 1 and coordinates on the tilted sensor, homogeneous.
  Eigen::Matrix3d tilted_from_plane_ = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d plane_from_tilted_ = Eigen::Matrix3d::Identity();
  double lean_[2] = {0.0, 0.0};  ///< x and y of the sensor's normal over its z
};

/// Pose from the paper's parameters: rows grow with range for both mirrored cameras.
Rigid3 sensor_from_camera(int side, double baseline, double height, double tilt);

/// The same with the camera's deviations from the plane of symmetry.
Rigid3 sensor_from_camera(const Camera& camera);

}  // namespace sensor_rt
