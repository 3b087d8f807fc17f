#include "sensor_rt/optics/camera.h"

#include <cmath>

namespace sensor_rt {
namespace {

struct Distorted {
  Eigen::Vector2d point;
  Eigen::Matrix2d jacobian;  ///< d point / d (x, y)
};

/// Brown-Conrady model in the order of OpenCV, on the plane z = 1.
Distorted distort(const std::array<double, 5>& k, double x, double y) {
  const auto [k1, k2, p1, p2, k3] = k;
  const double r2 = x * x + y * y;
  const double radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
  const double slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3);  // d radial / d r2
  Distorted d;
  d.point = {x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
             y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y};
  d.jacobian(0, 0) = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x;
  d.jacobian(0, 1) = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
  d.jacobian(1, 0) = d.jacobian(0, 1);
  d.jacobian(1, 1) = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x;
  return d;
}

}  // namespace

Eigen::Vector2d Camera::project(const Eigen::Vector3d& point_in_camera) const {
  const double x = point_in_camera.x() / point_in_camera.z();
  const double y = point_in_camera.y() / point_in_camera.z();
  const Eigen::Vector2d p = is_distorted() ? distort(distortion, x, y).point : Eigen::Vector2d(x, y);
  return {focal_px * p.x() + cx_px, focal_px * p.y() + cy_px};
}

Eigen::Vector3d Camera::ray(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector2d target((pixel.x() - cx_px) / focal_px, (pixel.y() - cy_px) / focal_px);
  Eigen::Vector2d p = target;
  if (is_distorted()) {
    for (int iteration = 0; iteration < 20; ++iteration) {
      const Distorted d = distort(distortion, p.x(), p.y());
      const Eigen::Vector2d step = d.jacobian.inverse() * (target - d.point);
      p += step;
      if (!(step.squaredNorm() > 1e-32)) break;
    }
  }
  return {p.x(), p.y(), 1.0};
}

Eigen::Matrix2d Camera::ray_jacobian(const Eigen::Vector3d& direction) const {
  const Eigen::Matrix2d per_direction = focal_px * distort(distortion, direction.x(), direction.y()).jacobian;
  return per_direction.inverse();
}

Eigen::Vector2d Camera::paper_coordinates(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector3d direction = ray(pixel);
  return {-side * focal_px * direction.x(), focal_px * direction.y()};
}

Rigid3 sensor_from_camera(int side, double baseline, double height, double tilt) {
  const double s = side;
  Rigid3 pose;
  pose.rotation.col(0) = Eigen::Vector3d(0.0, -s, 0.0);
  pose.rotation.col(1) = Eigen::Vector3d(s * std::cos(tilt), 0.0, std::sin(tilt));
  pose.rotation.col(2) = Eigen::Vector3d(-s * std::sin(tilt), 0.0, std::cos(tilt));
  pose.translation = Eigen::Vector3d(s * baseline, 0.0, height);
  return pose;
}

}  // namespace sensor_rt
