// Inputs and outputs of the gripper.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {

void add_gripper(TableBuilder& table, GripperCommandInputs& in, GripperOutputs& out,
                 const Dependencies& dependencies) {
  table.add_declared("command.gripper.", "the gripper", Causality::kInput, in);
  table.add_declared("", "the gripper", Causality::kOutput, out, dependencies);
}

}  // namespace robotcell::fmi
