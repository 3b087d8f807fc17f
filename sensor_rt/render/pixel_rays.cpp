#include "sensor_rt/render/pixel_rays.h"

#include <algorithm>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

/// Directions through the samples of a pixel: axes * (x, y, 1), x and y linear in the sample's offset.
SENSOR_RT_MULTIVERSION
void spread_directions(const double* __restrict axes, const double* __restrict ray,
                       const double* __restrict du, const double* __restrict dv, Lanes3& __restrict d) {
  for (int l = 0; l < kLanes; ++l) {
    const double x = ray[0] + ray[2] * du[l] + ray[3] * dv[l];
    const double y = ray[1] + ray[4] * du[l] + ray[5] * dv[l];
    d.x[l] = axes[0] * x + axes[3] * y + axes[6];
    d.y[l] = axes[1] * x + axes[4] * y + axes[7];
    d.z[l] = axes[2] * x + axes[5] * y + axes[8];
  }
}

}  // namespace

PixelRays::PixelRays(const RenderPlan& plan) : plan_(plan) {
  const std::size_t padded = plan.pattern.padded_size();
  eyes_.resize(padded / kLanes);
  for (std::size_t i = 0; i < padded; ++i) {
    const std::size_t sample = std::min(i, plan.pattern.size() - 1);
    sample_column_.push_back(plan.pattern.column[sample]);
    sample_row_.push_back(plan.pattern.row[sample]);
  }
}

void PixelRays::select_camera(std::size_t camera) {
  number_ = camera;
  camera_ = &plan_.settings.model.cameras[camera];
  for (int k = 0; k < 9; ++k) axes_[k] = camera_->sensor_from_camera.rotation(k % 3, k / 3);
  for (int k = 0; k < 3; ++k) eye_[k] = camera_->sensor_from_camera.translation[k];
  for (Lanes3& eyes : eyes_) {
    for (int l = 0; l < kLanes; ++l) set_lane(eyes, l, camera_->sensor_from_camera.translation);
  }
}

PixelRays::PixelRay PixelRays::pixel_ray(int column, int row) const {
  const double scale = 1.0 / camera_->focal_px;
  if (!camera_->is_distorted()) {
    return {(column - camera_->cx_px) * scale, (row - camera_->cy_px) * scale, scale, 0.0, 0.0, scale};
  }
  const Eigen::Vector3d middle = camera_->ray({column, row});
  const Eigen::Matrix2d slope = camera_->ray_jacobian(middle);
  return {middle.x(), middle.y(), slope(0, 0), slope(0, 1), slope(1, 0), slope(1, 1)};
}

void PixelRays::through_samples(int column, int row, std::size_t packet, Lanes3& direction) const {
  const PixelRay ray = pixel_ray(column, row);
  const double values[6] = {ray.x, ray.y, ray.dx_du, ray.dx_dv, ray.dy_du, ray.dy_dv};
  spread_directions(axes_, values, &sample_column_[packet * kLanes], &sample_row_[packet * kLanes],
                    direction);
}

void PixelRays::through_middle(int column, int row, Lanes3& direction) const {
  const PixelRay ray = pixel_ray(column, row);
  const double values[6] = {ray.x, ray.y, 0.0, 0.0, 0.0, 0.0};
  spread_directions(axes_, values, sample_column_.data(), sample_row_.data(), direction);
}

void PixelRays::through_corners(int column, const int* rows, int count, Lanes3& direction) const {
  for (int l = 0; l < kLanes; ++l) {
    const Eigen::Vector3d in_camera = camera_->ray({column - 0.5, rows[std::min(l, count - 1)] - 0.5});
    set_lane(direction, l, camera_->sensor_from_camera.rotation * in_camera);
  }
}

double PixelRays::electrons(int column, int row, double irradiance) const {
  const PixelRay ray = pixel_ray(column, row);
  const double cosine2 = 1.0 / (1.0 + ray.x * ray.x + ray.y * ray.y);
  return irradiance * cosine2 * cosine2 * plan_.electrons_per_irradiance[number_];
}

}  // namespace sensor_rt
