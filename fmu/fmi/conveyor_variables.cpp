// Inputs and outputs of the conveyors.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {

void add_conveyors(TableBuilder& table, CellInputs& in, CellOutputs& out) {
  const auto output = Causality::kOutput;
  const auto continuous = Variability::kContinuous;
  for (std::size_t i = 0; i < in.conveyors.size(); ++i) {
    const std::string belt = "the belt of conveyor " + std::to_string(i + 1);
    table.add(
        indexed("command.conveyor", i) + ".speed", Causality::kInput, Variability::kDiscrete, kMetrePerSecond,
        "Speed that " + belt +
            " shall have, negative for backwards, limited to the conveyor's largest; its drive takes it "
            "at the controller's next cycle and accelerates evenly",
        in.conveyors[i].speed);
  }
  for (std::size_t i = 0; i < out.conveyors.size(); ++i) {
    const std::string name = indexed("conveyor", i);
    const std::string belt = "the belt of conveyor " + std::to_string(i + 1);
    ConveyorOutputs& conveyor = out.conveyors[i];
    table.add(name + ".speed", output, continuous, kMetrePerSecond, "Speed of " + belt, conveyor.speed);
    table.add(name + ".travel", output, continuous, kMetre, "Way of " + belt + " since the start",
              conveyor.travel);
    table.add(name + ".texture_offset", output, continuous, kMetre,
              "Way of " + belt + " modulo the conveyor's length, by which a drawing shifts its texture",
              conveyor.texture_offset);
  }
}

}  // namespace robotcell::fmi
