#include "sensor_rt/optics/laser_emitter.h"

namespace sensor_rt {

LaserEmitter::LaserEmitter(const LaserSheet& laser)
    : sheet(laser),
      waist_depth(laser.waist_z - laser.source_z),
      sigma2(laser.sheet_sigma * laser.sheet_sigma),
      divergence2(laser.divergence * laser.divergence),
      tangent(std::tan(laser.fan_half_angle)),
      power_scale(laser.power / (2.0 * laser.fan_half_angle * std::sqrt(2.0 * M_PI))) {}

IncidentLight LaserEmitter::at(const Eigen::Vector3d& from_source) const {
  const double distance = from_source.norm();
  const double y = from_source.y();
  const double depth = from_source.z();
  if (!(depth > 0.0) || !in_fan(y, depth)) return {};
  const double across = from_source.x() - centre(y, depth);
  const double spread = variance(depth);
  const double profile = relative_power(y, depth) * std::exp(-0.5 * across * across / spread);
  return {-from_source / distance, profile * peak_irradiance(distance, spread, from_source.x(), y, depth)};
}

}  // namespace sensor_rt
