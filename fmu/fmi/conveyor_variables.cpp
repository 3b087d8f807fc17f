// Inputs and outputs of the conveyors.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {

void add_conveyors(TableBuilder& table, CellInputs& in, CellOutputs& out) {
  const auto output = Causality::kOutput;
  const auto continuous = Variability::kContinuous;
  for (std::size_t i = 0; i < in.conveyors.size(); ++i) {
    table.add(
        indexed("command.conveyor", i) + ".speed", Causality::kInput, Variability::kDiscrete, kMetrePerSecond,
        "Commanded speed of the belt of conveyor " + std::to_string(i + 1) +
            ", positive along x of the belt frame; clamped to the maximum speed, read at the next controller "
            "cycle, approached with constant acceleration",
        in.conveyors[i].speed);
  }
  for (std::size_t i = 0; i < out.conveyors.size(); ++i) {
    const std::string name = indexed("conveyor", i);
    const std::string belt = "the belt of conveyor " + std::to_string(i + 1);
    ConveyorOutputs& conveyor = out.conveyors[i];
    table.add(name + ".speed", output, continuous, kMetrePerSecond,
              "Speed of " + belt + ", positive along x of the belt frame", conveyor.speed);
    table.add(name + ".travel", output, continuous, kMetre,
              "Signed distance travelled by " + belt + " since the start", conveyor.travel);
    table.add(name + ".texture_offset", output, continuous, kMetre,
              "Distance travelled by " + belt + " modulo the belt length: texture offset for visualization",
              conveyor.texture_offset);
  }
}

}  // namespace robotcell::fmi
