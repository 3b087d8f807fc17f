// Motion of a conveyor belt: constant acceleration until the commanded speed is reached.
#pragma once

#include <cmath>

namespace robotcell::control {

struct BeltState {
  double travel = 0;  // m, distance travelled since the start
  double speed = 0;   // m/s
  double target = 0;  // m/s, commanded speed
};

/// State of the belt after `duration` seconds, in closed form.
inline BeltState run_belt(const BeltState& from, double acceleration, double duration) {
  const double change = from.target - from.speed;
  const double ramp = std::abs(change) / acceleration;  // s, until the target speed is reached
  if (ramp > duration) {
    const double signed_acceleration = std::copysign(acceleration, change);
    return {from.travel + (from.speed + 0.5 * signed_acceleration * duration) * duration,
            from.speed + signed_acceleration * duration, from.target};
  }
  return {from.travel + 0.5 * (from.speed + from.target) * ramp + from.target * (duration - ramp),
          from.target, from.target};
}

}  // namespace robotcell::control
