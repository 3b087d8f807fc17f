// Positions ahead of the robot, which a controller sends to its guard.
#pragma once

#include <array>
#include <cstddef>

#include "fmu/control/axis.h"

namespace robotcell::control {

/// Positions on the path ahead, a controller cycle apart: of path clock in programmed motion, of time in a
/// jog. The first one is the present set-point, so that a motion shorter than a cycle shows, too.
constexpr std::size_t kAheadPoints = 64;
using PathAhead = std::array<Axes, kAheadPoints>;

}  // namespace robotcell::control
