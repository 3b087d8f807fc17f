// Inputs of the controller and of the trigger.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

void add_trigger_commands(TableBuilder& table, TriggerCommand& trigger) {
  const auto input = Causality::kInput;
  const auto discrete = Variability::kDiscrete;
  table.add("command.trigger.mode", input, discrete, kNone,
            "Trigger mode of the sensor: 0 off; 1 periodic in time; 2 periodic in the table angle; 3 "
            "periodic in the "
            "distance travelled by the sensor over the table; 4 on request only. Modes 1 to 3 fire when the "
            "mode is "
            "entered or its interval is changed, and at every interval from there",
            trigger.mode);
  table.bound(0, 4);
  table.add("command.trigger.period", input, discrete, kSecond,
            "Time between two exposures in trigger mode 1; at least 1 microsecond", trigger.period);
  table.bound(0);
  table.add("command.trigger.angle", input, discrete, kRadian,
            "Rotation of the table, in either direction, between two exposures in trigger mode 2; above 0",
            trigger.angle);
  table.bound(0);
  table.add(
      "command.trigger.distance", input, discrete, kMetre,
      "Path length of the sensor origin in the rotating frame of the table between two exposures in trigger "
      "mode 3; above 0",
      trigger.distance);
  table.bound(0);
  table.add("command.trigger.request", input, discrete, kNone,
            "Counter: every increase fires one exposure, in any trigger mode but 0", trigger.request);
}

}  // namespace

void add_commands(TableBuilder& table, CellInputs& in) {
  add_motion_commands(table, in.motion);
  table.add("command.segment", Causality::kInput, Variability::kDiscrete, kNone,
            "Number of the current path segment, copied to the trigger records; no other effect", in.segment);
  add_trigger_commands(table, in.trigger);
  table.add("command.exposure", Causality::kInput, Variability::kDiscrete, kSecond,
            "Duration of exposures fired from now on; not negative", in.exposure);
  table.bound(0);
}

}  // namespace robotcell::fmi
