// Inputs and outputs of the gripper.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

void add_contact_forces(TableBuilder& table, GripperOutputs& out) {
  const auto output = Causality::kOutput;
  const auto discrete = Variability::kDiscrete;
  for (std::size_t i = 0; i < 2; ++i) {
    const std::string pad =
        " of the pad of finger " + std::to_string(i + 1) + " on all parts that it touches";
    const std::string name = indexed("truth.finger", i);
    table.add(name + ".normal_force", output, discrete, kNewton,
              "Normal force" + pad + " in the current dynamics step", out.normal_force[i]);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      table.add(indexed(name + ".contact_force", axis), output, discrete, kNewton,
                "Contact force" + pad + ", friction included, in the current dynamics step: " +
                    kAxisNames[axis] + " component, world frame",
                out.contact_force[i][axis]);
    }
  }
}

}  // namespace

void add_gripper(TableBuilder& table, GripperCommandInputs& in, GripperOutputs& out,
                 const Dependencies& dependencies) {
  const auto output = Causality::kOutput;
  const auto discrete = Variability::kDiscrete;
  table.add_declared("command.gripper.", "the gripper", Causality::kInput, in);
  table.add("measured.gripper.width", output, Variability::kContinuous, kMetre,
            "Measured distance between the pads of the two fingers", out.width, dependencies.file);
  table.add("measured.gripper.force", output, discrete, kNewton,
            "Measured closing force, mean of the two finger drives; negative while opening", out.force);
  table.add("measured.gripper.gripped", output, discrete, kNone,
            "True if the gripper holds an object: the fingers press with the commanded force and stand still "
            "without being closed",
            out.gripped);
  add_contact_forces(table, out);
}

}  // namespace robotcell::fmi
