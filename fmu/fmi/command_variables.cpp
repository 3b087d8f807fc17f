// Inputs of controller and trigger.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

void add_set_points(TableBuilder& table, CellInputs& in) {
  const auto input = Causality::kInput;
  const auto discrete = Variability::kDiscrete;
  const char* taken = "; the controller takes it at its next cycle and reaches it one cycle later";
  table.add("command.mode", input, discrete, kNone,
            "What the controller does: 0 brake and hold, 1 follow the set-points", in.mode);
  table.limit_integer(0, 1);
  for (std::size_t i = 0; i < kJoints; ++i) {
    table.add(indexed("command.q", i), input, discrete, kRadian,
              "Set-point of joint " + std::to_string(i + 1) + taken, in.position[i]);
  }
  table.add("command.table", input, discrete, kRadian, std::string("Set-point of the rotary table") + taken,
            in.position[kTableAxis]);
  table.add("command.segment", input, discrete, kNone,
            "Number of the path segment, handed through to the trigger records", in.segment);
}

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
  add_set_points(table, in);
  add_trigger_commands(table, in.trigger);
  table.add("command.exposure", Causality::kInput, Variability::kDiscrete, kSecond,
            "Duration of the exposures that fire from now on", in.exposure);
}

}  // namespace robotcell::fmi
