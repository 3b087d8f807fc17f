// Inputs of the controller and of the trigger.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {

void add_commands(TableBuilder& table, CellInputs& in, const std::string& prefix, Causality causality) {
  const auto variability = causality == Causality::kParameter ? Variability::kFixed : Variability::kDiscrete;
  table.add_declared(prefix, "the robot", causality, in.motion);
  table.add_declared(prefix + "pendant.", "the pendant", causality, in.pendant);
  table.add(
      prefix + "segment", causality, variability, kNone,
      "Number of the current path segment: copied to the trigger records, and in controller mode 6 the id of "
      "the segment that command.start starts",
      in.segment);
  table.add_declared(prefix + "trigger.", "the trigger", causality, in.trigger);
  table.add(prefix + "exposure", causality, variability, kSecond,
            "Duration of exposures fired from now on; not negative", in.exposure);
  table.bound(0, kMaxDuration);
}

}  // namespace robotcell::fmi
