#include "sensor_rt/optics/laser_sheet.h"

#include <cmath>

namespace sensor_rt {

double LaserSheet::sigma_at(double z) const { return std::hypot(sheet_sigma, divergence * (z - waist_z)); }

double LaserSheet::irradiance_at(double x, double y, double z) const {
  const double depth = z - source_z;
  if (!(depth > 0.0) || !(std::abs(std::atan2(y, depth)) <= fan_half_angle)) return 0.0;
  const double sigma = sigma_at(z);
  // Power per radian of fan, spread over the arc at this distance, times a Gaussian of unit area across the
  // sheet.
  const double per_metre = power / (2.0 * fan_half_angle * std::hypot(y, depth));
  constexpr double kInverseSqrtTwoPi = 0.3989422804014327;
  return per_metre * kInverseSqrtTwoPi / sigma * std::exp(-0.5 * (x / sigma) * (x / sigma));
}

}  // namespace sensor_rt
