// Inputs and outputs of conveyors, gripper, sensors and the collision monitor.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

/// Numbers of the bodies that collision outputs refer to.
std::string body_numbers(const CellLayout& layout) {
  std::string numbers = ", as a body number: 0 none";
  for (std::size_t i = 0; i < layout.bodies.size(); ++i) {
    numbers += ", " + std::to_string(i + 1) + " " + layout.bodies[i];
  }
  return numbers;
}

std::string conveyor_name(std::size_t index) { return "conveyor " + std::to_string(index + 1); }

}  // namespace

void add_conveyor_commands(TableBuilder& table, CellInputs& in, const std::string& prefix,
                           Causality causality) {
  for (std::size_t i = 0; i < in.conveyors.size(); ++i) {
    table.add_declared(indexed(prefix + "conveyor", i) + ".", conveyor_name(i), causality, in.conveyors[i]);
  }
}

void add_conveyors(TableBuilder& table, CellInputs& in, CellOutputs& out) {
  add_conveyor_commands(table, in);
  for (std::size_t i = 0; i < out.conveyors.size(); ++i) {
    table.add_declared(indexed("conveyor", i) + ".", conveyor_name(i), Causality::kOutput, out.conveyors[i]);
    table.add_declared(indexed("measured.conveyor", i) + ".", conveyor_name(i), Causality::kOutput,
                       out.belt_readings[i]);
    table.set_clocked(true);
    table.add_declared(indexed("trigger.measured.conveyor", i) + ".",
                       conveyor_name(i) + ", at the middle of the exposure of the current record",
                       Causality::kOutput, out.trigger.belts[i]);
    table.set_clocked(false);
  }
}

void add_gripper(TableBuilder& table, GripperCommand& in, GripperOutputs& out,
                 const Dependencies& dependencies) {
  table.add_declared("command.gripper.", "the gripper", Causality::kInput, in);
  table.add_declared("", "the gripper", Causality::kOutput, out, dependencies);
}

void add_sensing(TableBuilder& table, const CellLayout& layout, CellOutputs& out,
                 const Dependencies& dependencies) {
  for_each_sensor_kind([&](auto kind) {
    using Kind = SensorKind<kind>;
    auto& readings = std::get<kind>(out.readings.sensors);
    for (std::size_t i = 0; i < readings.size(); ++i) {
      table.add_declared(indexed(Kind::kVariables, i) + ".", Kind::kName + (" " + std::to_string(i + 1)),
                         Causality::kOutput, readings[i]);
    }
  });
  if (!layout.collision_outputs) return;
  table.add_declared("", body_numbers(layout), Causality::kOutput, out.readings.collision, dependencies);
}

}  // namespace robotcell::fmi
