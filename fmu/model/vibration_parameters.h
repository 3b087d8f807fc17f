// How one place of the cell vibrates. Plain numbers in SI units.
#pragma once

#include <array>

namespace robotcell {

struct VibrationParameters {
  std::array<double, 3> amplitude{};        // m, of a sine along the place's own axes
  double frequency = 0;                     // Hz
  double phase = 0;                         // rad, at the start
  double random_rms = 0;                    // m, along each axis
  double random_low = 0, random_width = 0;  // Hz, where the band of the random part starts, and its width
};

}  // namespace robotcell
