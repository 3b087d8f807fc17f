// Outputs of the sensors and the collision monitor.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

constexpr auto kOutput = Causality::kOutput;
constexpr auto kDiscrete = Variability::kDiscrete;

void add_collision(TableBuilder& table, const CellLayout& layout, CollisionReading& reading,
                   const Refs& file) {
  const std::string prefix = "truth.collision.";
  std::string names = ", as a body number: 0 none";
  for (std::size_t i = 0; i < layout.bodies.size(); ++i) {
    names += ", " + std::to_string(i + 1) + " " + layout.bodies[i];
  }
  const std::string instant = " at the last controller cycle";
  table.add(prefix + "pairs", kOutput, kDiscrete, kNone,
            "Number of monitored pairs of bodies whose surfaces intersect" + instant, reading.pairs);
  table.add(prefix + "body_a", kOutput, kDiscrete, kNone, "First body of the deepest collision" + names,
            reading.body_a);
  table.add(prefix + "body_b", kOutput, kDiscrete, kNone, "Second body of the deepest collision" + names,
            reading.body_b);
  table.add(prefix + "depth", kOutput, kDiscrete, kMetre,
            "Penetration depth of the deepest collision" + instant, reading.depth);
  for (std::size_t i = 0; i < 3; ++i) {
    table.add(indexed(prefix + "point", i), kOutput, kDiscrete, kMetre,
              std::string("Deepest point of the deepest collision: ") + kAxisNames[i] + " in the world frame",
              reading.point[i]);
  }
  const std::string near = "truth.clearance.";
  table.add(near + "distance", kOutput, kDiscrete, kMetre,
            "Smallest distance of all monitored pairs of bodies, 0 during a collision, at most the collision "
            "range of the description" +
                instant,
            reading.clearance, file);
  table.add(near + "body_a", kOutput, kDiscrete, kNone, "First body of the closest pair" + names,
            reading.near_a);
  table.add(near + "body_b", kOutput, kDiscrete, kNone, "Second body of the closest pair" + names,
            reading.near_b);
}

}  // namespace

void add_sensing(TableBuilder& table, const CellLayout& layout, CellOutputs& out,
                 const Dependencies& dependencies) {
  for_each_sensor_kind([&](auto kind) {
    using Kind = SensorKind<kind>;
    auto& readings = std::get<kind>(out.readings.sensors);
    for (std::size_t i = 0; i < readings.size(); ++i) {
      table.add_declared(indexed(Kind::kVariables, i) + ".", Kind::kName + (" " + std::to_string(i + 1)),
                         kOutput, readings[i]);
    }
  });
  if (layout.collision_outputs) add_collision(table, layout, out.readings.collision, dependencies.file);
}

}  // namespace robotcell::fmi
