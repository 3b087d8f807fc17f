// Inputs and outputs of the gripper.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

void add_commands(TableBuilder& table, GripperCommandInputs& in) {
  const auto input = Causality::kInput;
  const auto discrete = Variability::kDiscrete;
  table.add(
      "command.gripper.mode", input, discrete, kNone,
      "What the gripper does from the controller's next cycle on: 0 go on with what it was told last (at "
      "first: keep its opening), 1 open or close to command.gripper.width, 2 close with "
      "command.gripper.force",
      in.mode);
  table.limit_integer(0, 2);
  table.add("command.gripper.width", input, discrete, kMetre,
            "Distance between the pads of the two fingers in mode 1, limited to the gripper's stroke; the "
            "fingers move at their largest speed and press with up to their largest force",
            in.width);
  table.add("command.gripper.force", input, discrete, kNewton,
            "Force of each finger in mode 2, limited to the gripper's largest; the fingers approach at their "
            "largest speed",
            in.force);
}

void add_contact_forces(TableBuilder& table, GripperOutputs& out) {
  const auto output = Causality::kOutput;
  const auto discrete = Variability::kDiscrete;
  for (std::size_t i = 0; i < 2; ++i) {
    const std::string pad =
        " of the pad of finger " + std::to_string(i + 1) + " on the parts that it touches";
    const std::string name = indexed("truth.finger", i);
    table.add(name + ".normal_force", output, discrete, kNewton,
              "True normal force" + pad + ", in the present dynamics step", out.normal_force[i]);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      table.add(indexed(name + ".contact_force", axis), output, discrete, kNewton,
                "True force" + pad + ", friction included, along the world's " + kAxisNames[axis] +
                    ", in the present dynamics step",
                out.contact_force[i][axis]);
    }
  }
}

}  // namespace

void add_gripper(TableBuilder& table, GripperCommandInputs& in, GripperOutputs& out,
                 const Dependencies& known) {
  const auto output = Causality::kOutput;
  const auto discrete = Variability::kDiscrete;
  add_commands(table, in);
  table.add("measured.gripper.width", output, Variability::kContinuous, kMetre,
            "Distance between the pads of the two fingers", out.width, known.file);
  table.add("measured.gripper.force", output, discrete, kNewton,
            "Closing force of the fingers' drives, mean of both; negative while they open", out.force);
  table.add("measured.gripper.gripped", output, discrete, kNone,
            "Whether the fingers hold something: they press with the force that they were told and stand "
            "still, but are not closed",
            out.gripped);
  add_contact_forces(table, out);
}

}  // namespace robotcell::fmi
