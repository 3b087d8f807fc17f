// Units of time: the cell's clock counts whole microseconds from the start.
#pragma once

namespace robotcell {

constexpr double kSecondsPerMicrosecond = 1e-6;
constexpr double kMicrosecondsPerSecond = 1e6;

/// s. Simulation times are below it: there a double resolves half a microsecond. Unix times reach it in 2106.
constexpr double kMaxTime = 4294967296;

}  // namespace robotcell
