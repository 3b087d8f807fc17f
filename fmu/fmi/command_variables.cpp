// Inputs of the controller and of the trigger.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {

void add_commands(TableBuilder& table, CellInputs& in) {
  const auto input = Causality::kInput;
  table.add_declared("command.", "the robot", input, in.motion);
  table.add_declared("command.pendant.", "the pendant", input, in.pendant);
  table.add(
      "command.segment", input, Variability::kDiscrete, kNone,
      "Number of the current path segment: copied to the trigger records, and in controller mode 6 the id of "
      "the segment that command.start starts",
      in.segment);
  table.add_declared("command.trigger.", "the trigger", input, in.trigger);
  table.add("command.exposure", input, Variability::kDiscrete, kSecond,
            "Duration of exposures fired from now on; not negative", in.exposure);
  table.bound(0, kMaxDuration);
}

}  // namespace robotcell::fmi
