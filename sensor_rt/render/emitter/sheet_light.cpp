#include "sensor_rt/render/emitter/sheet_light.h"

#include <cmath>

#include "sensor_rt/geometry/fast_math.h"
#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/render/render_plan.h"

namespace sensor_rt {
namespace {

/// Common viewpoint and source for all lanes, planar sheet.
struct Simple {
  const double* viewpoint;
  double viewpoint_x(int) const { return viewpoint[0]; }
  double viewpoint_y(int) const { return viewpoint[1]; }
  double viewpoint_z(int) const { return viewpoint[2]; }
  double source_y(int) const { return 0.0; }
  double middle(const LaserEmitter&, double, double) const { return 0.0; }
};

/// Individual viewpoint and source per lane, bent sheet.
struct General {
  const Lanes3* viewpoint;
  const Lanes3* source;
  double viewpoint_x(int l) const { return viewpoint->x[l]; }
  double viewpoint_y(int l) const { return viewpoint->y[l]; }
  double viewpoint_z(int l) const { return viewpoint->z[l]; }
  double source_y(int l) const { return source->y[l]; }
  double middle(const LaserEmitter& laser, double y, double depth) const { return laser.centre(y, depth); }
};

/// Conditions are combined by & and applied as factors: the loop vectorises only without branches.
template <typename Geometry>
[[gnu::always_inline]] inline void light_lanes(const LaserEmitter& laser, const Geometry& g,
                                               const Lanes3& __restrict d, const PacketHits& __restrict hits,
                                               Lanes3& __restrict from_source, double* __restrict irradiance,
                                               double* __restrict unoccluded) {
  for (int l = 0; l < kLanes; ++l) {
    const double t = hits.t[l] < kNoHit ? hits.t[l] : 1.0;
    const double x = g.viewpoint_x(l) + t * d.x[l];
    const double y = g.viewpoint_y(l) + t * d.y[l] - g.source_y(l);
    const double depth = g.viewpoint_z(l) + t * d.z[l] - laser.sheet.source_z;
    const double across = x - g.middle(laser, y, depth);
    const double variance = laser.variance(depth);
    const double nx = hits.normal.x[l];
    const double ny = hits.normal.y[l];
    const double nz = hits.normal.z[l];
    // Two-sided surfaces: the visible side must be the lit side.
    const double to_viewpoint = -(nx * d.x[l] + ny * d.y[l] + nz * d.z[l]);
    const double to_source = -(nx * x + ny * y + nz * depth);
    const double facing = to_viewpoint < 0.0 ? -to_source : to_source;
    const double in_sheet = across * across <= kSheetReach * kSheetReach * variance ? 1.0 : 0.0;
    const double in_fan = laser.in_fan(y, depth) ? 1.0 : 0.0;
    const double in_front = facing > 0.0 ? 1.0 : 0.0;
    const double in_light = in_sheet * in_fan * in_front;
    const double exponent = -0.5 * across * across / variance;
    irradiance[l] = in_light * exp_negative(exponent > -600.0 ? exponent : -600.0) *
                    laser.peak_irradiance(facing, variance, x, y, depth);
    unoccluded[l] = in_light;
    from_source.x[l] = x;
    from_source.y[l] = y;
    from_source.z[l] = depth;
  }
}

SENSOR_RT_MULTIVERSION
void light_simply(const LaserEmitter& laser, const double* viewpoint, const Lanes3& d, const PacketHits& hits,
                  Lanes3& from_source, double* irradiance, double* unoccluded) {
  light_lanes(laser, Simple{viewpoint}, d, hits, from_source, irradiance, unoccluded);
}

SENSOR_RT_MULTIVERSION
void light_generally(const LaserEmitter& laser, const Lanes3& viewpoint, const Lanes3& source,
                     const Lanes3& d, const PacketHits& hits, Lanes3& from_source, double* irradiance,
                     double* unoccluded) {
  light_lanes(laser, General{&viewpoint, &source}, d, hits, from_source, irradiance, unoccluded);
}

}  // namespace

void SheetLight::light(const double* viewpoint, const Lanes3& direction, const PacketHits& hits,
                       Lanes3& from_source, double* irradiance, int* lit) const {
  alignas(64) double unoccluded[kLanes];
  light_simply(laser_, viewpoint, direction, hits, from_source, irradiance, unoccluded);
  for (int l = 0; l < kLanes; ++l) lit[l] = unoccluded[l] > 0.0 ? -1 : 0;
}

void SheetLight::light(const Lanes3& viewpoint, const Lanes3& source, const Lanes3& direction,
                       const PacketHits& hits, Lanes3& from_source, double* irradiance, int* lit) const {
  alignas(64) double unoccluded[kLanes];
  light_generally(laser_, viewpoint, source, direction, hits, from_source, irradiance, unoccluded);
  for (int l = 0; l < kLanes; ++l) {
    if (unoccluded[l] > 0.0 && !laser_.sheet.is_even()) {
      irradiance[l] *= laser_.relative_power(from_source.y[l], from_source.z[l]);
      unoccluded[l] = irradiance[l];
    }
    lit[l] = unoccluded[l] > 0.0 ? -1 : 0;
  }
}

}  // namespace sensor_rt
