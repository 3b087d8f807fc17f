#include "sensor_rt/optics/trapezoid.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace sensor_rt {

namespace {

[[noreturn]] void reject_unbounded(const Camera& camera) {
  throw std::invalid_argument(
      "camera " + camera.name +
      ": tilt must exceed the vertical half angle, or its field of view is unbounded");
}

/// Returns (|y|, z) of the point of the plane X = 0 that a pixel sees.
Eigen::Vector2d in_sheet(const Camera& camera, double column, double row) {
  const Eigen::Vector3d viewpoint = camera.sensor_from_camera.translation;
  const Eigen::Vector3d ray_in_sensor = camera.sensor_from_camera.rotation * camera.ray({column, row});
  if (!(-ray_in_sensor.x() * camera.side > 0.0)) reject_unbounded(camera);
  const Eigen::Vector3d point = viewpoint - viewpoint.x() / ray_in_sensor.x() * ray_in_sensor;
  return {std::abs(point.y()), point.z()};
}

/// Returns the largest trapezoid within the quadrilateral that the four image corners see.
Trapezoid trapezoid_of_corners(const Camera& camera) {
  const double right = camera.width_px - 0.5;
  const double bottom = camera.height_px - 0.5;
  const Eigen::Vector2d near_left = in_sheet(camera, -0.5, -0.5);
  const Eigen::Vector2d near_right = in_sheet(camera, right, -0.5);
  const Eigen::Vector2d far_left = in_sheet(camera, -0.5, bottom);
  const Eigen::Vector2d far_right = in_sheet(camera, right, bottom);
  const double z_near = std::max(near_left.y(), near_right.y());
  const double z_far = std::min(far_left.y(), far_right.y());
  const double y_near = std::min(near_left.x(), near_right.x());
  const double y_far = std::min(far_left.x(), far_right.x());
  Trapezoid corners;
  corners << -y_near, z_near, y_near, z_near, y_far, z_far, -y_far, z_far;
  return corners;
}

double half_angle(const Camera& camera) { return std::atan(0.5 * camera.height_px / camera.focal_px); }

/// Returns the trapezoid of Eq. 5 whose half-widths are a `width` / sin(phi ± gamma).
Trapezoid trapezoid_of_width(const Camera& camera, double width) {
  const double gamma = half_angle(camera);
  if (camera.tilt <= gamma) reject_unbounded(camera);
  const double z_near = camera.height() + camera.baseline() / std::tan(camera.tilt + gamma);
  const double z_far = camera.height() + camera.baseline() / std::tan(camera.tilt - gamma);
  const double y_near = camera.baseline() * width / std::sin(camera.tilt + gamma);
  const double y_far = camera.baseline() * width / std::sin(camera.tilt - gamma);
  Trapezoid corners;
  corners << -y_near, z_near, y_near, z_near, y_far, z_far, -y_far, z_far;
  return corners;
}

}  // namespace

Trapezoid range_trapezoid(const Camera& camera) {
  const bool is_centred =
      camera.cx_px == 0.5 * (camera.width_px - 1) && camera.cy_px == 0.5 * (camera.height_px - 1);
  if (camera.is_tilted() || !is_centred) return trapezoid_of_corners(camera);
  const double aspect = static_cast<double>(camera.width_px) / camera.height_px;
  return trapezoid_of_width(camera, aspect * std::sin(half_angle(camera)));
}

Trapezoid range_trapezoid_as_printed(const Camera& camera) {
  return trapezoid_of_width(camera, std::tan(half_angle(camera)));
}

}  // namespace sensor_rt
