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
  const BodyState tool = body_state(attached({}, nominal.flange_from_sensor()));
  inputs.motion.tool_position = tool.position;
  inputs.motion.tool_orientation = tool.orientation;
  const BodyState sensor = body_state(nominal.frame(nominal.numbers().sensor(), inputs.motion.position, {}));
  inputs.motion.target_position = sensor.position;
  inputs.motion.target_orientation = sensor.orientation;
  if (cell.gripper) inputs.gripper.width = cell.gripper->start;
  return inputs;
}

}  // namespace robotcell
