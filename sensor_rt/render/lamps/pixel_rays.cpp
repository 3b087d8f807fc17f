#include "sensor_rt/render/lamps/pixel_rays.h"

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

/// Computes the directions through the samples of a pixel: axes * (x, y, 1), with x and y linear in the
/// sample offset.
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

/// Computes the directions from points (a, b) of a lens. `focus`: inverse depth in focus, linear in x and y.
SENSOR_RT_MULTIVERSION
void spread_through_lens(const double* __restrict axes, const double* __restrict ray,
                         const double* __restrict du, const double* __restrict dv, const double* __restrict a,
                         const double* __restrict b, const double* __restrict focus, Lanes3& __restrict d) {
  for (int l = 0; l < kLanes; ++l) {
    const double u = ray[0] + ray[2] * du[l] + ray[3] * dv[l];
    const double v = ray[1] + ray[4] * du[l] + ray[5] * dv[l];
    const double vergence = focus[0] + focus[1] * u + focus[2] * v;
    const double x = u - a[l] * vergence;
    const double y = v - b[l] * vergence;
    d.x[l] = axes[0] * x + axes[3] * y + axes[6];
    d.y[l] = axes[1] * x + axes[4] * y + axes[7];
    d.z[l] = axes[2] * x + axes[5] * y + axes[8];
  }
}

}  // namespace

PixelRays::PixelRays(const RenderPlan& plan, std::size_t camera)
    : number_(camera),
      camera_(plan.settings.model.cameras[camera]),
      samples_(plan.samples[camera]),
      electrons_per_irradiance_(plan.electrons_per_irradiance[camera]) {
  for (int k = 0; k < 9; ++k) axes_[k] = camera_.sensor_from_camera.rotation(k % 3, k / 3);
  if (share_viewpoint()) return;
  focus_[0] = camera_.vergence(0.0, 0.0);
  focus_[1] = camera_.vergence(1.0, 0.0) - focus_[0];
  focus_[2] = camera_.vergence(0.0, 1.0) - focus_[0];
}

PixelRays::PixelRay PixelRays::pixel_ray(int column, int row) const {
  const double scale = 1.0 / camera_.focal_px;
  if (camera_.is_plain()) {
    return {(column - camera_.cx_px) * scale, (row - camera_.cy_px) * scale, scale, 0.0, 0.0, scale};
  }
  const Eigen::Vector3d middle = camera_.ray({column, row});
  const Eigen::Matrix2d slope = camera_.ray_jacobian(middle);
  return {middle.x(), middle.y(), slope(0, 0), slope(0, 1), slope(1, 0), slope(1, 1)};
}

void PixelRays::through_samples(int column, int row, std::size_t packet, Lanes3& direction) const {
  const PixelRay ray = pixel_ray(column, row);
  const double* du = &samples_.column[packet * kLanes];
  const double* dv = &samples_.row[packet * kLanes];
  const double values[6] = {ray.x, ray.y, ray.dx_du, ray.dx_dv, ray.dy_du, ray.dy_dv};
  if (share_viewpoint()) {
    spread_directions(axes_, values, du, dv, direction);
  } else {
    spread_through_lens(axes_, values, du, dv, &samples_.lens_x[packet * kLanes],
                        &samples_.lens_y[packet * kLanes], focus_, direction);
  }
}

void PixelRays::through_centre(int column, int row, Lanes3& direction) const {
  constexpr double kCentre[kLanes] = {};
  const PixelRay ray = pixel_ray(column, row);
  const double values[6] = {ray.x, ray.y, ray.dx_du, ray.dx_dv, ray.dy_du, ray.dy_dv};
  spread_directions(axes_, values, kCentre, kCentre, direction);
}

double PixelRays::electrons(int column, int row, double irradiance) const {
  const PixelRay ray = pixel_ray(column, row);
  const double cosine2 = 1.0 / (1.0 + ray.x * ray.x + ray.y * ray.y);
  const double area = camera_.is_tilted() ? camera_.tilt_area(Eigen::Vector2d(column, row)) : 1.0;
  return irradiance * cosine2 * cosine2 * area * electrons_per_irradiance_;
}

}  // namespace sensor_rt
