// Positions ahead of the robot, which a controller sends to its guard.
#pragma once

#include <array>
#include <cstddef>

#include "fmu/control/axis.h"

namespace robotcell::control {

/// Positions on the path ahead of the present instant, a controller cycle apart, as the set-points of
/// programs are: of path clock in programmed motion, of time in a jog.
constexpr std::size_t kAheadPoints = 64;
using PathAhead = std::array<Axes, kAheadPoints>;

}  // namespace robotcell::control
