#include "sensor_rt/render/sheet_light.h"

#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/render/render_plan.h"

namespace sensor_rt {
namespace {

constexpr double kNone = std::numeric_limits<double>::infinity();

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

/// One eye and one source for all lanes, the sheet is a plane.
struct Simple {
  const double* eye;
  double eye_x(int) const { return eye[0]; }
  double eye_y(int) const { return eye[1]; }
  double eye_z(int) const { return eye[2]; }
  double source_y(int) const { return 0.0; }
  double middle(const SheetLight::Constants&, double, double) const { return 0.0; }
};

/// An eye and a source for each lane, the sheet is bent.
struct General {
  const Lanes3* eye;
  const Lanes3* source;
  double eye_x(int l) const { return eye->x[l]; }
  double eye_y(int l) const { return eye->y[l]; }
  double eye_z(int l) const { return eye->z[l]; }
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

/// Conditions are joined by & and applied as factors: without branches the loop vectorises.
template <typename Geometry>
[[gnu::always_inline]] inline void light_lanes(const SheetLight::Constants& s, const Geometry& g,
                                               const Lanes3& __restrict d, const PacketHits& __restrict hits,
                                               Lanes3& __restrict from_source, double* __restrict irradiance,
                                               double* __restrict open) {
  for (int l = 0; l < kLanes; ++l) {
    const double t = hits.t[l] < kNone ? hits.t[l] : 1.0;
    const double x = g.eye_x(l) + t * d.x[l];
    const double y = g.eye_y(l) + t * d.y[l] - g.source_y(l);
    const double depth = g.eye_z(l) + t * d.z[l] - s.source_z;
    const double across = x - g.middle(s, y, depth);
    const double from_waist = depth - s.waist_depth;
    const double sigma2 = s.sigma2 + s.divergence2 * from_waist * from_waist;
    const double in_fan2 = y * y + depth * depth;
    const double nx = hits.normal.x[l];
    const double ny = hits.normal.y[l];
    const double nz = hits.normal.z[l];
    // Two-sided: the side that the camera sees is the side that must be lit.
    const double to_eye = -(nx * d.x[l] + ny * d.y[l] + nz * d.z[l]);
    const double to_source = -(nx * x + ny * y + nz * depth);
    const double facing = to_eye < 0.0 ? -to_source : to_source;
    const double in_sheet = across * across <= s.reach2 * sigma2 ? 1.0 : 0.0;
    const double in_fan = std::abs(y) <= s.tangent * depth ? 1.0 : 0.0;
    const double in_front = facing > 0.0 ? 1.0 : 0.0;
    const double shine = in_sheet * in_fan * in_front;
    const double exponent = -0.5 * across * across / sigma2;
    // The Gaussian's 1/sigma, the fan's 1/radius and the cosine's 1/distance under one root, which is kept
    // from 0.
    const double scale = 1.0 / std::sqrt(sigma2 * in_fan2 * (in_fan2 + x * x) + 1e-200);
    irradiance[l] =
        shine * s.power_per_radian * exp_negative(exponent > -600.0 ? exponent : -600.0) * facing * scale;
    open[l] = shine;
    from_source.x[l] = x;
    from_source.y[l] = y;
    from_source.z[l] = depth;
  }
}

SENSOR_RT_MULTIVERSION
void light_simply(const SheetLight::Constants& s, const double* eye, const Lanes3& d, const PacketHits& hits,
                  Lanes3& from_source, double* irradiance, double* open) {
  light_lanes(s, Simple{eye}, d, hits, from_source, irradiance, open);
}

SENSOR_RT_MULTIVERSION
void light_generally(const SheetLight::Constants& s, const Lanes3& eye, const Lanes3& source, const Lanes3& d,
                     const PacketHits& hits, Lanes3& from_source, double* irradiance, double* open) {
  light_lanes(s, General{&eye, &source}, d, hits, from_source, irradiance, open);
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

void SheetLight::light(const double* eye, const Lanes3& direction, const PacketHits& hits,
                       Lanes3& from_source, double* irradiance, int* lit) const {
  alignas(64) double open[kLanes];
  light_simply(constants_, eye, direction, hits, from_source, irradiance, open);
  for (int l = 0; l < kLanes; ++l) lit[l] = open[l] > 0.0 ? -1 : 0;
}

void SheetLight::light(const Lanes3& eye, const Lanes3& source, const Lanes3& direction,
                       const PacketHits& hits, Lanes3& from_source, double* irradiance, int* lit) const {
  alignas(64) double open[kLanes];
  light_generally(constants_, eye, source, direction, hits, from_source, irradiance, open);
  for (int l = 0; l < kLanes; ++l) {
    if (open[l] > 0.0 && !laser_.is_even()) {
      irradiance[l] *= laser_.relative_power(std::atan2(from_source.y[l], from_source.z[l]));
      open[l] = irradiance[l];
    }
    lit[l] = open[l] > 0.0 ? -1 : 0;
  }
}

}  // namespace sensor_rt
