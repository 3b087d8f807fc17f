// Vibration of one body of the cell, in SI units.
#pragma once

#include <array>

namespace robotcell {

struct VibrationParameters {
  std::array<double, 3> amplitude{};        // m, of a sine along each axis of the body
  double frequency = 0;                     // Hz
  double phase = 0;                         // rad, at time 0
  double random_rms = 0;                    // m, along each axis
  double random_low = 0, random_width = 0;  // Hz, lower limit and width of the band of the random part
};

}  // namespace robotcell
