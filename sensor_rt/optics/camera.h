// Camera of the profile sensor: thin lens with Brown-Conrady distortion and a sensor plane that may be
// tilted.
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
  int side = 1;  ///< +1: camera at sensor X > 0, -1: its mirror image
  Rigid3 sensor_from_camera;
  double tilt = 0.0;       ///< phi: nominal angle of the optical axis from sensor Z towards the sheet, rad
  bool is_aligned = true;  ///< the pose fulfils the assumptions of the paper's formulas
  int width_px = 0;
  int height_px = 0;
  double focal_px = 0.0;
  double cx_px = 0.0;
  double cy_px = 0.0;
  std::array<double, 5> distortion{};  ///< k1, k2, p1, p2, k3 (OpenCV order)
  double f_number = 0.0;               ///< working f-number: image distance over diameter of the aperture
  double pixel_pitch = 0.0;            ///< m
  double transmission = 0.0;           ///< lens times band-pass filter, 0..1
  double focus = 0.0;         ///< m: distance of the plane in focus on the optical axis; 0: no depth of field
  double psf_sigma_px = 0.0;  ///< standard deviation of the point spread function in focus

  /// Returns a: the distance of the optical centre from the plane X = 0, m.
  double baseline() const { return side * sensor_from_camera.translation.x(); }
  /// Returns b: the sensor Z of the optical centre, m.
  double height() const { return sensor_from_camera.translation.z(); }

  bool is_distorted() const { return distortion != std::array<double, 5>{}; }
  bool is_tilted() const { return is_tilted_; }
  /// True for a pinhole camera: no distortion, no sensor tilt.
  bool is_plain() const { return !is_distorted() && !is_tilted(); }
  bool has_depth_of_field() const { return focus > 0.0; }

  /// Tilts the image sensor (Scheimpflug): rotations about camera x, then y, around the point where the
  /// optical axis meets it; OpenCV's tau_x and tau_y.
  void tilt_sensor(double about_x, double about_y);

  double image_distance() const { return focal_px * pixel_pitch; }
  double aperture_radius() const { return 0.5 * image_distance() / f_number; }
  /// Returns the width of a grain of speckle on the image, px.
  double grain_px(double wavelength) const { return wavelength * f_number / pixel_pitch; }

  /// Returns the inverse depth, 1/m, at which the direction (x, y, 1) is in focus. A thin lens maps the
  /// sensor plane to a plane of focus, so that this is linear in x and y: 1/focus on the axis, less where the
  /// sensor is tilted away (Scheimpflug principle).
  double vergence(double x, double y) const {
    return 1.0 / focus - (lean_[0] * x + lean_[1] * y) / image_distance();
  }

  /// Returns the pixel of a point in the camera frame for light through one point of the lens, `lens` (m)
  /// from the lens centre.
  Eigen::Vector2d project_through(const Eigen::Vector2d& lens, const Eigen::Vector3d& point_in_camera) const;

  /// Returns an upper bound of the blur radius in pixels: the distance between the images of a point by light
  /// through the centre and through the rim of the lens.
  double blur_radius_px(const Eigen::Vector3d& point_in_camera) const;

  /// Returns the area on the plane normal to the optical axis that a pixel of the tilted sensor covers,
  /// relative to that of an untilted pixel.
  double tilt_area(const Eigen::Vector2d& pixel) const;

  /// Returns the pixel (column, row) of a point in the camera frame (z > 0), distortion applied.
  Eigen::Vector2d project(const Eigen::Vector3d& point_in_camera) const;

  /// Limits of the lens model, as radii about the optical axis.
  struct Reach {
    double direction;  ///< of directions (x, y, 1)
    double image_px;   ///< of the image before the tilt of the sensor, px
  };

  /// Returns the radii up to which the distortion has an inverse, at most those of a direction 80 degrees off
  /// the axis. Its Jacobian is symmetric, hence within the disc of directions in which it stays positive
  /// definite the distortion is the gradient of a convex function, and one-to-one.
  Reach reach() const;

  /// Returns the distance of a pixel from the optical axis in the image before the tilt of the sensor, px.
  double axis_distance_px(const Eigen::Vector2d& pixel) const;

  /// Returns the viewing direction (x, y, 1) of a pixel (column, row) in the camera frame, distortion
  /// removed. Valid within reach().
  Eigen::Vector3d ray(const Eigen::Vector2d& pixel) const;

  /// Jacobian d (x, y) / d (column, row) of `ray` at the direction (x, y, 1).
  Eigen::Matrix2d ray_jacobian(const Eigen::Vector3d& direction) const;

  /// The paper's p = (p_x along sensor +Y, p_y towards larger range), px from the principal point,
  /// undistorted.
  Eigen::Vector2d paper_coordinates(const Eigen::Vector2d& pixel) const;

 private:
  Eigen::Vector2d tilted(const Eigen::Vector2d& on_plane) const;
  Eigen::Vector2d untilted(const Eigen::Vector2d& on_sensor) const;

  // Homographies between the plane normal to the axis at distance 1 and coordinates on the tilted sensor.
  bool is_tilted_ = false;
  Eigen::Matrix3d tilted_from_plane_ = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d plane_from_tilted_ = Eigen::Matrix3d::Identity();
  double lean_[2] = {0.0, 0.0};  ///< x and y of the sensor's normal over its z
};

/// Returns electrons per second and per W/m² of diffusely reflected irradiance, for a pixel on the optical
/// axis. A Lambertian surface that reflects the irradiance E has the radiance E/pi; a lens of working
/// f-number N turns radiance L into the irradiance pi L / (4 N²) on the axis of the image plane.
double electrons_per_irradiance(const Camera& camera, double wavelength, double quantum_efficiency);

/// Returns the camera pose for the paper's parameters. Rows increase with range for both mirrored cameras.
Rigid3 sensor_from_camera(int side, double baseline, double height, double tilt);

}  // namespace sensor_rt
