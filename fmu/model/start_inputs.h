// Start values of inputs that depend on the cell.
#pragma once

#include <array>
#include <cstddef>

#include "fmu/model/cell_values.h"
#include "fmu/model/description/cell_description.h"

namespace robotcell {

/// Inputs that start at the home pose of the cell: set-points of all axes, tool, its target, width of the
/// gripper.
constexpr std::size_t kHomeInputs = kAxes + 2 * (3 + 4) + 1;
std::array<double*, kHomeInputs> home_inputs(CellInputs& inputs);

/// Start values of all inputs, with the home pose from the nominal geometry.
CellInputs start_inputs(const CellDescription& cell);

}  // namespace robotcell
