#include "fmu/control/smooth_profile.h"

#include <algorithm>
#include <cmath>

namespace robotcell::control {

SmoothProfile SmoothProfile::over(double distance, const ProfileLimits& limits) {
  // A short distance leaves no time to cruise: the two ramps of v t / 2 each then cover it.
  const double by_acceleration = std::sqrt(limits.acceleration * distance / 1.5);
  const double by_jerk = std::cbrt(distance * distance * limits.jerk / 6);
  const double speed = std::min({limits.speed, by_acceleration, by_jerk});
  const double ramp = std::max(1.5 * speed / limits.acceleration, std::sqrt(6 * speed / limits.jerk));
  return {distance, speed, ramp};
}

ProfilePoint SmoothProfile::at(double time) const {
  const double end = duration();
  if (time <= 0) return {0, 0, 0};
  if (time >= end) return {distance, 0, 0};
  const double from_end = end - time;
  if (time >= ramp && from_end >= ramp) return {speed * (time - ramp / 2), speed, 0};
  const bool slows = from_end < time;
  const double u = (slows ? from_end : time) / ramp;
  const double travel = speed * ramp * u * u * u * (1 - u / 2);
  const double acceleration = 6 * speed / ramp * u * (1 - u);
  return {slows ? distance - travel : travel, speed * u * u * (3 - 2 * u),
          slows ? -acceleration : acceleration};
}

}  // namespace robotcell::control
