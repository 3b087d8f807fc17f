#include "sensor_rt/fan/stripe_optics.h"

#include <cmath>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

SENSOR_RT_MULTIVERSION
void project_stripes(const StripeOptics::Constants& c, const Lanes3& __restrict d, const Lanes3& __restrict n,
                     const Lanes3& __restrict du, const Lanes3& __restrict dv, const double* __restrict area,
                     const HitLight& __restrict light, StripeLanes& __restrict out) {
  for (int l = 0; l < kLanes; ++l) {
    const double depth = c.forward[0] * d.x[l] + c.forward[1] * d.y[l] + c.forward[2] * d.z[l];
    const double inverse = 1.0 / depth;
    const double ax = d.x[l] * inverse;
    const double ay = d.y[l] * inverse;
    const double az = d.z[l] * inverse;
    const double facing = 1.0 / (n.x[l] * ax + n.y[l] * ay + n.z[l] * az);
    const double turn_u = (n.x[l] * du.x[l] + n.y[l] * du.y[l] + n.z[l] * du.z[l]) * facing;
    const double turn_v = (n.x[l] * dv.x[l] + n.y[l] * dv.y[l] + n.z[l] * dv.z[l]) * facing;
    // Displacement across the sheet per pixel step, on the tangent plane.
    const double across_u = depth * (du.x[l] - ax * turn_u);
    const double across_v = depth * (dv.x[l] - ax * turn_v);
    const double per_across = 1.0 / across_v;
    const double slope = across_u * per_across;
    const double peak_ratio = std::abs(light.sigma[l] * per_across);
    const double x = c.right[0] * ax + c.right[1] * ay + c.right[2] * az;
    const double y = c.down[0] * ax + c.down[1] * ay + c.down[2] * az;
    // A uniform disc of radius r has the variance r²/4 along any axis.
    const double disc = c.aperture_px * (c.vergence[0] + c.vergence[1] * x + c.vergence[2] * y - inverse);
    const double spread2 = c.psf2 + 0.25 * disc * disc;
    const double shift = light.normal_travel[l] * ax * facing * per_across;
    const double width = std::sqrt(peak_ratio * peak_ratio + spread2 * (1.0 + slope * slope) +
                                   (1.0 / 12.0) * (slope * slope + shift * shift));
    const double cosine2 = 1.0 / (ax * ax + ay * ay + az * az);
    out.responsivity[l] = c.responsivity * cosine2 * cosine2 * area[l];
    out.peak_ratio[l] = peak_ratio / width;
    out.width[l] = width;
  }
}

void fill(double (&to)[3], const Eigen::Vector3d& from) {
  for (int k = 0; k < 3; ++k) to[k] = from[k];
}

}  // namespace

StripeOptics::StripeOptics(const Camera& camera, double electrons_per_irradiance)
    : camera_(camera), constants_{} {
  const Eigen::Matrix3d& axes = camera.sensor_from_camera.rotation;
  fill(constants_.right, axes.col(0));
  fill(constants_.down, axes.col(1));
  fill(constants_.forward, axes.col(2));
  constants_.responsivity = electrons_per_irradiance;
  constants_.psf2 = camera.psf_sigma_px * camera.psf_sigma_px;
  if (camera.has_depth_of_field()) {
    constants_.aperture_px = camera.aperture_radius() * camera.focal_px;
    constants_.vergence[0] = camera.vergence(0.0, 0.0);
    constants_.vergence[1] = camera.vergence(1.0, 0.0) - constants_.vergence[0];
    constants_.vergence[2] = camera.vergence(0.0, 1.0) - constants_.vergence[0];
  }
  for (int l = 0; l < kLanes; ++l) {
    set_lane(per_column_, l, axes.col(0) / camera.focal_px);
    set_lane(per_row_, l, axes.col(1) / camera.focal_px);
    area_[l] = 1.0;
  }
}

void StripeOptics::measure(const Lanes3& from_viewpoint, const Lanes3& normal, const double* column,
                           const double* row, const HitLight& light, StripeLanes& stripes) const {
  if (camera_.is_plain()) {
    project_stripes(constants_, from_viewpoint, normal, per_column_, per_row_, area_, light, stripes);
    return;
  }
  const Eigen::Matrix3d& axes = camera_.sensor_from_camera.rotation;
  Lanes3 per_column;
  Lanes3 per_row;
  alignas(64) double area[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    const Eigen::Vector3d in_camera = axes.transpose() * lane(from_viewpoint, l);
    const Eigen::Matrix2d slope = camera_.ray_jacobian(in_camera / in_camera.z());
    set_lane(per_column, l, axes.leftCols<2>() * slope.col(0));
    set_lane(per_row, l, axes.leftCols<2>() * slope.col(1));
    area[l] = camera_.is_tilted() ? camera_.tilt_area({column[l], row[l]}) : 1.0;
  }
  project_stripes(constants_, from_viewpoint, normal, per_column, per_row, area, light, stripes);
}

}  // namespace sensor_rt
