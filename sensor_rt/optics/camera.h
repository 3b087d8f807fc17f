// Pinhole camera of the profile sensor, with Brown-Conrady distortion.
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
  Rigid3 sensor_from_camera;           ///< follows from side, baseline, height, tilt

  bool is_distorted() const { return distortion != std::array<double, 5>{}; }

  /// Pixel (column, row) of a point in the camera frame (z > 0), distortion applied.
  Eigen::Vector2d project(const Eigen::Vector3d& point_in_camera) const;

  /// Direction (x, y, 1) in the camera frame seen by pixel (column, row), distortion removed.
  Eigen::Vector3d ray(const Eigen::Vector2d& pixel) const;

  /// d (x, y) / d (column, row) of `ray` at the direction (x, y, 1).
  Eigen::Matrix2d ray_jacobian(const Eigen::Vector3d& direction) const;

  /// The paper's p = (p_x along sensor +Y, p_y towards larger range), px from the principal point,
  /// undistorted.
  Eigen::Vector2d paper_coordinates(const Eigen::Vector2d& pixel) const;
};

/// Pose from the paper's parameters: rows grow with range for both mirrored cameras.
Rigid3 sensor_from_camera(int side, double baseline, double height, double tilt);

}  // namespace sensor_rt
