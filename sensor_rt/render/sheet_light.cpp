#include "sensor_rt/render/sheet_light.h"

#include <cmath>
#include <cstdint>
#include <cstring>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/render/render_plan.h"

namespace sensor_rt {
namespace {

/// exp for -600 <= x <= 0 to 1e-12 relative, free of branches and calls so that loops over lanes vectorise.
inline double exp_negative(double x) {
  constexpr double kRound =
      6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer, kept in the low bits
  const double shifted = x * 1.4426950408889634 + kRound;
  const double whole = shifted - kRound;
  const double f = (x - whole * 0.6931471805599453);
  // Taylor series on |f| <= ln(2)/2
  double sum = 1.0 / 39916800.0;
  sum = sum * f + 1.0 / 3628800.0;
  sum = sum * f + 1.0 / 362880.0;
  sum = sum * f + 1.0 / 40320.0;
  sum = sum * f + 1.0 / 5040.0;
  sum = sum * f + 1.0 / 720.0;
  sum = sum * f + 1.0 / 120.0;
  sum = sum * f + 1.0 / 24.0;
  sum = sum * f + 1.0 / 6.0;
  sum = sum * f + 0.5;
  sum = sum * f + 1.0;
  sum = sum * f + 1.0;
  std::uint64_t bits;
  std::memcpy(&bits, &shifted, sizeof bits);
  bits = (bits + 1023) << 52;
  double power;
  std::memcpy(&power, &bits, sizeof power);
  return sum * power;
}

SENSOR_RT_MULTIVERSION
void light_lanes(const SheetLight::Constants& s, const double* eye, const Lanes3& d, const PacketHits& hits,
                 Lanes3& from_source, double* irradiance, int* lit) {
  for (int l = 0; l < kLanes; ++l) {
    const bool hit = hits.shape[l] >= 0;
    const double t = hit ? hits.t[l] : 0.0;
    const double x = eye[0] + t * d.x[l];
    const double y = eye[1] + t * d.y[l];
    const double z = eye[2] + t * d.z[l];
    const double depth = z - s.source_z;
    const double from_waist = z - s.waist_z;
    const double sigma2 = s.sigma2 + s.divergence2 * from_waist * from_waist;
    const double in_fan2 = y * y + depth * depth;
    const double nx = hits.normal.x[l];
    const double ny = hits.normal.y[l];
    const double nz = hits.normal.z[l];
    // Two-sided: the side that the camera sees is the side that must be lit.
    const double to_eye = -(nx * d.x[l] + ny * d.y[l] + nz * d.z[l]);
    const double to_source = -(nx * x + ny * y + nz * depth);
    const double cosine = (to_eye < 0.0 ? -to_source : to_source) / std::sqrt(in_fan2 + x * x);
    const bool inside = hit && depth > 0.0 && x * x <= s.reach2 * sigma2 && std::abs(y) <= s.tangent * depth;
    const bool bright = inside && cosine > 0.0;
    const double exponent = -0.5 * x * x / sigma2;
    const double profile = exp_negative(bright ? exponent : 0.0) / std::sqrt(sigma2 * in_fan2);
    irradiance[l] = bright ? s.power_per_radian * profile * cosine : 0.0;
    from_source.x[l] = x;
    from_source.y[l] = y;
    from_source.z[l] = depth;
    lit[l] = bright ? -1 : 0;
  }
}

}  // namespace

SheetLight::SheetLight(const LaserSheet& laser) {
  constexpr double kInverseSqrtTwoPi = 0.3989422804014327;
  constants_ = {laser.source_z,
                laser.waist_z,
                laser.sheet_sigma * laser.sheet_sigma,
                laser.divergence * laser.divergence,
                kSheetReach * kSheetReach,
                std::tan(laser.fan_half_angle),
                kInverseSqrtTwoPi * laser.power / (2.0 * laser.fan_half_angle)};
}

void SheetLight::light(const double* eye, const Lanes3& direction, const PacketHits& hits,
                       Lanes3& from_source, double* irradiance, int* lit) const {
  light_lanes(constants_, eye, direction, hits, from_source, irradiance, lit);
}

}  // namespace sensor_rt
