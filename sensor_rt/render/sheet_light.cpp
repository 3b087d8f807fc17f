#include "sensor_rt/render/sheet_light.h"

#include <cmath>
#include <limits>

#include "sensor_rt/geometry/fast_math.h"
#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/render/render_plan.h"

namespace sensor_rt {
namespace {

constexpr double kNone = std::numeric_limits<double>::infinity();

/// Common viewpoint and source for all lanes, planar sheet.
struct Simple {
  const double* viewpoint;
  double viewpoint_x(int) const { return viewpoint[0]; }
  double viewpoint_y(int) const { return viewpoint[1]; }
  double viewpoint_z(int) const { return viewpoint[2]; }
  double source_y(int) const { return 0.0; }
  double middle(const SheetLight::Constants&, double, double) const { return 0.0; }
};

/// Individual viewpoint and source per lane, bent sheet.
struct General {
  const Lanes3* viewpoint;
  const Lanes3* source;
  double viewpoint_x(int l) const { return viewpoint->x[l]; }
  double viewpoint_y(int l) const { return viewpoint->y[l]; }
  double viewpoint_z(int l) const { return viewpoint->z[l]; }
  double source_y(int l) const { return source->y[l]; }
  double middle(const SheetLight::Constants& s, double y, double depth) const {
    const double ahead = depth > 1e-9 ? depth : 1e-9;
    const double place = y / (ahead * s.tangent);
    double bend = 0.0;
    for (int k = LaserSheet::kStraightness; k-- > 0;) {
      bend = bend * place + s.straightness[static_cast<std::size_t>(k)];
    }
    return ahead * bend;
  }
};

/// Conditions are combined by & and applied as factors: the loop vectorises only without branches.
template <typename Geometry>
[[gnu::always_inline]] inline void light_lanes(const SheetLight::Constants& s, const Geometry& g,
                                               const Lanes3& __restrict d, const PacketHits& __restrict hits,
                                               Lanes3& __restrict from_source, double* __restrict irradiance,
                                               double* __restrict unoccluded) {
  for (int l = 0; l < kLanes; ++l) {
    const double t = hits.t[l] < kNone ? hits.t[l] : 1.0;
    const double x = g.viewpoint_x(l) + t * d.x[l];
    const double y = g.viewpoint_y(l) + t * d.y[l] - g.source_y(l);
    const double depth = g.viewpoint_z(l) + t * d.z[l] - s.source_z;
    const double across = x - g.middle(s, y, depth);
    const double from_waist = depth - s.waist_depth;
    const double sigma2 = s.sigma2 + s.divergence2 * from_waist * from_waist;
    const double in_fan2 = y * y + depth * depth;
    const double nx = hits.normal.x[l];
    const double ny = hits.normal.y[l];
    const double nz = hits.normal.z[l];
    // Two-sided surfaces: the visible side must be the lit side.
    const double to_viewpoint = -(nx * d.x[l] + ny * d.y[l] + nz * d.z[l]);
    const double to_source = -(nx * x + ny * y + nz * depth);
    const double facing = to_viewpoint < 0.0 ? -to_source : to_source;
    const double in_sheet = across * across <= s.reach2 * sigma2 ? 1.0 : 0.0;
    const double in_fan = std::abs(y) <= s.tangent * depth ? 1.0 : 0.0;
    const double in_front = facing > 0.0 ? 1.0 : 0.0;
    const double shine = in_sheet * in_fan * in_front;
    const double exponent = -0.5 * across * across / sigma2;
    // The Gaussian's 1/sigma, the fan's 1/radius and the cosine's 1/distance share one square root, whose
    // argument is kept positive.
    const double scale = 1.0 / std::sqrt(sigma2 * in_fan2 * (in_fan2 + x * x) + 1e-200);
    irradiance[l] =
        shine * s.power_per_radian * exp_negative(exponent > -600.0 ? exponent : -600.0) * facing * scale;
    unoccluded[l] = shine;
    from_source.x[l] = x;
    from_source.y[l] = y;
    from_source.z[l] = depth;
  }
}

SENSOR_RT_MULTIVERSION
void light_simply(const SheetLight::Constants& s, const double* viewpoint, const Lanes3& d,
                  const PacketHits& hits, Lanes3& from_source, double* irradiance, double* unoccluded) {
  light_lanes(s, Simple{viewpoint}, d, hits, from_source, irradiance, unoccluded);
}

SENSOR_RT_MULTIVERSION
void light_generally(const SheetLight::Constants& s, const Lanes3& viewpoint, const Lanes3& source,
                     const Lanes3& d, const PacketHits& hits, Lanes3& from_source, double* irradiance,
                     double* unoccluded) {
  light_lanes(s, General{&viewpoint, &source}, d, hits, from_source, irradiance, unoccluded);
}

}  // namespace

SheetLight::SheetLight(const LaserSheet& laser) : laser_(laser) {
  constexpr double kInverseSqrtTwoPi = 0.3989422804014327;
  constants_ = {laser.source_z,
                laser.waist_z - laser.source_z,
                laser.sheet_sigma * laser.sheet_sigma,
                laser.divergence * laser.divergence,
                kSheetReach * kSheetReach,
                std::tan(laser.fan_half_angle),
                kInverseSqrtTwoPi * laser.power / (2.0 * laser.fan_half_angle),
                laser.straightness};
}

void SheetLight::light(const double* viewpoint, const Lanes3& direction, const PacketHits& hits,
                       Lanes3& from_source, double* irradiance, int* lit) const {
  alignas(64) double unoccluded[kLanes];
  light_simply(constants_, viewpoint, direction, hits, from_source, irradiance, unoccluded);
  for (int l = 0; l < kLanes; ++l) lit[l] = unoccluded[l] > 0.0 ? -1 : 0;
}

void SheetLight::light(const Lanes3& viewpoint, const Lanes3& source, const Lanes3& direction,
                       const PacketHits& hits, Lanes3& from_source, double* irradiance, int* lit) const {
  alignas(64) double unoccluded[kLanes];
  light_generally(constants_, viewpoint, source, direction, hits, from_source, irradiance, unoccluded);
  for (int l = 0; l < kLanes; ++l) {
    if (unoccluded[l] > 0.0 && !laser_.is_even()) {
      irradiance[l] *= laser_.relative_power(std::atan2(from_source.y[l], from_source.z[l]));
      unoccluded[l] = irradiance[l];
    }
    lit[l] = unoccluded[l] > 0.0 ? -1 : 0;
  }
}

}  // namespace sensor_rt
