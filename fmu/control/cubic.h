// Cubic Hermite interpolation of the motion of one axis.
#pragma once

#include <algorithm>
#include <cmath>

namespace robotcell::control {

/// Position and velocity of an axis at one instant (rad, rad/s).
struct Knot {
  double position = 0;
  double velocity = 0;
};

/// Interpolates from `start` to `end`, `duration` seconds apart, at the fraction s of the duration.
inline Knot cubic_between(const Knot& start, const Knot& end, double duration, double s) {
  const double travel = end.position - start.position;
  const double v0 = start.velocity * duration;
  const double v1 = end.velocity * duration;
  const double quadratic = 3 * travel - 2 * v0 - v1;
  const double cubic = v0 + v1 - 2 * travel;
  return {start.position + s * (v0 + s * (quadratic + s * cubic)),
          (v0 + s * (2 * quadratic + s * 3 * cubic)) / duration};
}

/// Largest absolute acceleration along the cubic. Acceleration is linear in time, so it occurs at an end.
inline double peak_acceleration(const Knot& start, const Knot& end, double duration) {
  const double mean = (end.position - start.position) / duration;
  const double at_start = 6 * mean - 4 * start.velocity - 2 * end.velocity;
  const double at_end = 2 * start.velocity + 4 * end.velocity - 6 * mean;
  return std::max(std::abs(at_start), std::abs(at_end)) / duration;
}

}  // namespace robotcell::control
