// Units of time: the cell's clock counts whole microseconds from the start.
#pragma once

namespace robotcell {

constexpr double kSecondsPerMicrosecond = 1e-6;
constexpr double kMicrosecondsPerSecond = 1e6;

}  // namespace robotcell
