// Inputs and outputs of the conveyors.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {

void add_conveyors(TableBuilder& table, CellInputs& in, CellOutputs& out) {
  const auto device = [](std::size_t i) { return "conveyor " + std::to_string(i + 1); };
  for (std::size_t i = 0; i < in.conveyors.size(); ++i) {
    table.add_declared(indexed("command.conveyor", i) + ".", device(i), Causality::kInput, in.conveyors[i]);
  }
  for (std::size_t i = 0; i < out.conveyors.size(); ++i) {
    table.add_declared(indexed("conveyor", i) + ".", device(i), Causality::kOutput, out.conveyors[i]);
  }
}

}  // namespace robotcell::fmi
