#include "sensor_rt/optics/projector.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

SENSOR_RT_MULTIVERSION
void project_pinhole(const double* __restrict r, const double* __restrict t, double focal, double cx,
                     double cy, const Lanes3& __restrict p, double* __restrict column,
                     double* __restrict row) {
  for (int l = 0; l < kLanes; ++l) {
    const double x = r[0] * p.x[l] + r[1] * p.y[l] + r[2] * p.z[l] + t[0];
    const double y = r[3] * p.x[l] + r[4] * p.y[l] + r[5] * p.z[l] + t[1];
    const double z = r[6] * p.x[l] + r[7] * p.y[l] + r[8] * p.z[l] + t[2];
    const double u = focal * (x / z) + cx;
    const double v = focal * (y / z) + cy;
    column[l] = z > 1e-6 ? u : kNotVisible;
    row[l] = z > 1e-6 ? v : kNotVisible;
  }
}

}  // namespace

Projector::Projector(const Camera& camera) : camera_(camera) {
  const Rigid3 camera_from_sensor = camera.sensor_from_camera.inverse();
  for (int k = 0; k < 9; ++k) rotation_[k] = camera_from_sensor.rotation(k / 3, k % 3);
  for (int k = 0; k < 3; ++k) translation_[k] = camera_from_sensor.translation[k];
  if (camera.is_plain()) return;
  const double off_axis = std::abs(camera.cx_px) + std::abs(camera.cy_px);
  const double farthest_px =
      std::min(camera.width_px + camera.height_px + off_axis, camera.focal_px * camera.reach().direction);
  reach2_ = farthest_px * farthest_px;
}

void Projector::project(const Lanes3& points_in_sensor, double* column, double* row) const {
  project_pinhole(rotation_, translation_, camera_.focal_px, camera_.cx_px, camera_.cy_px, points_in_sensor,
                  column, row);
  if (camera_.is_plain()) return;
  // Beyond its reach the lens model may fold back into the image.
  for (int l = 0; l < kLanes; ++l) {
    const double x = column[l] - camera_.cx_px;
    const double y = row[l] - camera_.cy_px;
    const bool in_field = x * x + y * y < reach2_;
    const Eigen::Vector2d pixel = camera_.project({x / camera_.focal_px, y / camera_.focal_px, 1.0});
    column[l] = in_field ? pixel.x() : kNotVisible;
    row[l] = in_field ? pixel.y() : kNotVisible;
  }
}

}  // namespace sensor_rt
