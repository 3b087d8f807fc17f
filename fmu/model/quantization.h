// Quantisation of measured values.
#pragma once

#include <cmath>

namespace robotcell {

/// The multiple of `resolution` nearest to `value`; `value` itself where the resolution is 0 or finer than
/// that of a double, and the number of steps overflows.
inline double quantized(double value, double resolution) {
  constexpr double kExactSteps = 9007199254740992.0;  // 2^53
  if (!(resolution > 0)) return value;
  const double steps = value / resolution;
  return std::abs(steps) < kExactSteps ? resolution * std::nearbyint(steps) : value;
}

}  // namespace robotcell
