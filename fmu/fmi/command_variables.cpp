// Inputs of the trigger, behind those of the controller.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

void add_trigger_commands(TableBuilder& table, TriggerCommand& trigger) {
  const auto input = Causality::kInput;
  const auto discrete = Variability::kDiscrete;
  table.add("command.trigger.mode", input, discrete, kNone,
            "What fires the sensor: 0 nothing, 1 time, 2 angle of the table, 3 path of the sensor over the "
            "table, 4 requests alone; a mode counts from the instant at which it is entered (or its interval "
            "changed) and fires there first",
            trigger.mode);
  table.limit_integer(0, 4);
  table.add("command.trigger.period", input, discrete, kSecond, "Time between two exposures in mode 1",
            trigger.period);
  table.add("command.trigger.angle", input, discrete, kRadian,
            "Angle of the table between two exposures in mode 2", trigger.angle);
  table.add("command.trigger.distance", input, discrete, kMetre,
            "Path of the sensor's origin, as seen from the turning table, between two exposures in mode 3",
            trigger.distance);
  table.add("command.trigger.request", input, discrete, kNone,
            "Every increase fires the sensor once, in any mode but 0", trigger.request);
}

}  // namespace

void add_commands(TableBuilder& table, CellInputs& in) {
  add_motion_commands(table, in.motion);
  table.add("command.segment", Causality::kInput, Variability::kDiscrete, kNone,
            "Number of the path segment, handed through to the trigger records", in.segment);
  add_trigger_commands(table, in.trigger);
  table.add("command.exposure", Causality::kInput, Variability::kDiscrete, kSecond,
            "Duration of the exposures that fire from now on", in.exposure);
}

}  // namespace robotcell::fmi
