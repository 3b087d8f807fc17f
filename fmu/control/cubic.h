// The cubic between two instants of an axis' motion.
#pragma once

#include <algorithm>
#include <cmath>

namespace robotcell::control {

/// Where an axis is and how fast it moves (rad, rad/s).
struct Knot {
  double position = 0;
  double velocity = 0;
};

/// Cubic Hermite interpolation from `start` to `end` in `duration` seconds, at the share s of it.
inline Knot cubic_between(const Knot& start, const Knot& end, double duration, double s) {
  const double travel = end.position - start.position;
  const double v0 = start.velocity * duration;
  const double v1 = end.velocity * duration;
  const double quadratic = 3 * travel - 2 * v0 - v1;
  const double cubic = v0 + v1 - 2 * travel;
  return {start.position + s * (v0 + s * (quadratic + s * cubic)),
          (v0 + s * (2 * quadratic + s * 3 * cubic)) / duration};
}

/// Greatest acceleration along that cubic; it is at one of the ends.
inline double greatest_acceleration(const Knot& start, const Knot& end, double duration) {
  const double mean = (end.position - start.position) / duration;
  const double at_start = 6 * mean - 4 * start.velocity - 2 * end.velocity;
  const double at_end = 2 * start.velocity + 4 * end.velocity - 6 * mean;
  return std::max(std::abs(at_start), std::abs(at_end)) / duration;
}

}  // namespace robotcell::control
