#include "fmu/model/start_inputs.h"

#include "fmu/model/world/kinematics.h"

namespace robotcell {

std::array<double*, kHomeInputs> home_inputs(CellInputs& inputs) {
  std::array<double*, kHomeInputs> members;
  std::size_t count = 0;
  for (double& axis : inputs.motion.position) members[count++] = &axis;
  for (double& coordinate : inputs.motion.tool_position) members[count++] = &coordinate;
  for (double& coordinate : inputs.motion.tool_orientation) members[count++] = &coordinate;
  for (double& coordinate : inputs.motion.target_position) members[count++] = &coordinate;
  for (double& coordinate : inputs.motion.target_orientation) members[count++] = &coordinate;
  members[count] = &inputs.gripper.width;
  return members;
}

CellInputs start_inputs(const CellDescription& cell) {
  CellInputs inputs(layout_of(cell));
  inputs.motion.position = start_positions(cell);
  const Kinematics nominal(cell, AsBuilt{});
  const Eigen::Isometry3d flange_from_tool = nominal.flange_from_tool();
  const BodyState tool = body_state(attached({}, flange_from_tool));
  inputs.motion.tool_position = tool.position;
  inputs.motion.tool_orientation = tool.orientation;
  const Motion flange = nominal.frame(nominal.numbers().flange(), inputs.motion.position, {});
  const BodyState target = body_state(attached(flange, flange_from_tool));
  inputs.motion.target_position = target.position;
  inputs.motion.target_orientation = target.orientation;
  if (cell.gripper) inputs.gripper.width = cell.gripper->start;
  return inputs;
}

}  // namespace robotcell
