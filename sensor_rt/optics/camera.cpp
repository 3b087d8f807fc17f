#include "sensor_rt/optics/camera.h"

#include <algorithm>
#include <cmath>
#include <limits>

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

void Camera::tilt_sensor(double about_x, double about_y) {
  if (about_x == 0.0 && about_y == 0.0) return;
  // Rows: axes and normal of the sensor in the camera frame.
  const Eigen::Matrix3d axes = (Eigen::AngleAxisd(-about_y, Eigen::Vector3d::UnitY()) *
                                Eigen::AngleAxisd(-about_x, Eigen::Vector3d::UnitX()))
                                   .toRotationMatrix();
  // A ray d intersects the sensor plane at d n_z / (n d); coordinates count from the optical axis.
  Eigen::Matrix3d from_axis = Eigen::Matrix3d::Identity();
  from_axis(0, 0) = from_axis(1, 1) = axes(2, 2);
  from_axis(0, 2) = -axes(0, 2);
  from_axis(1, 2) = -axes(1, 2);
  tilted_from_plane_ = from_axis * axes;
  plane_from_tilted_ = tilted_from_plane_.inverse();
  is_tilted_ = true;
  lean_[0] = axes(2, 0) / axes(2, 2);
  lean_[1] = axes(2, 1) / axes(2, 2);
}

Eigen::Vector2d Camera::tilted(const Eigen::Vector2d& on_plane) const {
  return (tilted_from_plane_ * on_plane.homogeneous()).hnormalized();
}

Eigen::Vector2d Camera::untilted(const Eigen::Vector2d& on_sensor) const {
  return (plane_from_tilted_ * on_sensor.homogeneous()).hnormalized();
}

double Camera::tilt_area(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector3d on_sensor((pixel.x() - cx_px) / focal_px, (pixel.y() - cy_px) / focal_px, 1.0);
  const double scale = plane_from_tilted_.row(2).dot(on_sensor);
  return plane_from_tilted_.determinant() / (scale * scale * scale);
}

Eigen::Vector2d Camera::project_through(const Eigen::Vector2d& lens,
                                        const Eigen::Vector3d& point_in_camera) const {
  // Light of direction (x, y) through the lens point l follows l + depth ((x, y) - l vergence(x, y));
  // vergence is linear in (x, y).
  const Eigen::Vector2d lean(lean_[0] / image_distance(), lean_[1] / image_distance());
  const Eigen::Matrix2d slope = Eigen::Matrix2d::Identity() + lens * lean.transpose();
  const Eigen::Vector2d seen = (point_in_camera.head<2>() - lens) / point_in_camera.z() + lens / focus;
  const Eigen::Vector2d direction = slope.inverse() * seen;
  return project({direction.x(), direction.y(), 1.0});
}

double Camera::blur_radius_px(const Eigen::Vector3d& point_in_camera) const {
  const double x = point_in_camera.x() / point_in_camera.z();
  const double y = point_in_camera.y() / point_in_camera.z();
  const double spread = aperture_radius() * std::abs(vergence(x, y) - 1.0 / point_in_camera.z());
  // With a tilted sensor the vergence at the image of the lens rim differs slightly.
  const double slack = 1.0 - aperture_radius() * std::hypot(lean_[0], lean_[1]) / image_distance();
  const Eigen::Matrix2d per_slope = ray_jacobian({x, y, 1.0}).inverse();
  constexpr double kCurved = 1.05;  // margin: the image scale varies within the blur disc
  return kCurved * spread / slack * per_slope.norm();
}

Eigen::Vector2d Camera::project(const Eigen::Vector3d& point_in_camera) const {
  const double x = point_in_camera.x() / point_in_camera.z();
  const double y = point_in_camera.y() / point_in_camera.z();
  const Eigen::Vector2d p = is_distorted() ? distort(distortion, x, y).point : Eigen::Vector2d(x, y);
  const Eigen::Vector2d s = is_tilted() ? tilted(p) : p;
  return {focal_px * s.x() + cx_px, focal_px * s.y() + cy_px};
}

Camera::Reach Camera::reach() const {
  constexpr double kFarthest = 5.67;  // tangent of 80 degrees
  constexpr int kSteps = 400;
  constexpr int kDirections = 32;
  const bool is_radial = distortion[2] == 0.0 && distortion[3] == 0.0;
  Reach reach{kFarthest, std::numeric_limits<double>::infinity()};
  for (int i = 0; i < (is_radial ? 1 : kDirections); ++i) {
    const Eigen::Vector2d direction(std::cos(2.0 * M_PI * i / kDirections),
                                    std::sin(2.0 * M_PI * i / kDirections));
    const auto folds = [&](double radius) {
      return !(distort(distortion, radius * direction.x(), radius * direction.y()).jacobian.determinant() >
               0.0);
    };
    for (int step = 1; step <= kSteps; ++step) {
      double beyond = kFarthest * step / kSteps;
      if (beyond >= reach.direction) break;
      if (!folds(beyond)) continue;
      double within = kFarthest * (step - 1) / kSteps;
      for (int k = 0; k < 40; ++k)
        (folds(0.5 * (within + beyond)) ? beyond : within) = 0.5 * (within + beyond);
      reach.direction = within;
      break;
    }
  }
  for (int i = 0; i < (is_radial ? 1 : kDirections); ++i) {
    const Eigen::Vector2d rim = reach.direction * Eigen::Vector2d(std::cos(2.0 * M_PI * i / kDirections),
                                                                  std::sin(2.0 * M_PI * i / kDirections));
    reach.image_px = std::min(reach.image_px, focal_px * distort(distortion, rim.x(), rim.y()).point.norm());
  }
  return reach;
}

double Camera::axis_distance_px(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector2d on_sensor((pixel.x() - cx_px) / focal_px, (pixel.y() - cy_px) / focal_px);
  return focal_px * (is_tilted() ? untilted(on_sensor) : on_sensor).norm();
}

Eigen::Vector3d Camera::ray(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector2d on_sensor((pixel.x() - cx_px) / focal_px, (pixel.y() - cy_px) / focal_px);
  const Eigen::Vector2d target = is_tilted() ? untilted(on_sensor) : on_sensor;
  Eigen::Vector2d p = target;
  if (is_distorted()) {
    // Newton's method, whose first step from the axis is `target`; steps that lead away are halved.
    Eigen::Vector2d step = target;
    double last = target.squaredNorm();
    for (int iteration = 0; iteration < 100; ++iteration) {
      const Distorted d = distort(distortion, p.x(), p.y());
      const Eigen::Vector2d rest = target - d.point;
      if ((rest.squaredNorm() > last || !(d.jacobian.determinant() > 0.0)) && step.squaredNorm() > 1e-20) {
        step *= 0.5;
        p -= step;
        continue;
      }
      last = rest.squaredNorm();
      step = d.jacobian.inverse() * rest;
      p += step;
      if (!(step.squaredNorm() > 1e-32)) break;
    }
  }
  return {p.x(), p.y(), 1.0};
}

Eigen::Matrix2d Camera::ray_jacobian(const Eigen::Vector3d& direction) const {
  const Distorted d = distort(distortion, direction.x(), direction.y());
  Eigen::Matrix2d per_direction = focal_px * d.jacobian;
  if (is_tilted()) {
    const Eigen::Vector3d h = tilted_from_plane_ * d.point.homogeneous();
    const Eigen::Matrix2d tilt = (tilted_from_plane_.topLeftCorner<2, 2>() -
                                  h.hnormalized() * tilted_from_plane_.bottomLeftCorner<1, 2>()) /
                                 h.z();
    per_direction = focal_px * tilt * d.jacobian;
  }
  return per_direction.inverse();
}

Eigen::Vector2d Camera::paper_coordinates(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector3d direction = ray(pixel);
  return {-side * focal_px * direction.x(), focal_px * direction.y()};
}

double electrons_per_irradiance(const Camera& camera, double wavelength, double quantum_efficiency) {
  constexpr double kPlanck = 6.62607015e-34;
  constexpr double kLightSpeed = 299792458.0;
  const double image_irradiance = camera.transmission / (4.0 * camera.f_number * camera.f_number);
  const double photons_per_joule = wavelength / (kPlanck * kLightSpeed);
  return image_irradiance * camera.pixel_pitch * camera.pixel_pitch * photons_per_joule * quantum_efficiency;
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
