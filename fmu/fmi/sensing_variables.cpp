// Outputs of presence sensors, distance sensors and the collision monitor.
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
  for (std::size_t i = 0; i < out.presence.size(); ++i) {
    table.add(indexed("presence", i) + ".detected", kOutput, kDiscrete, kNone,
              "True if any part intersected the volume of presence sensor " + std::to_string(i + 1) +
                  " at its last reading; false before the first reading",
              out.presence[i].detected);
  }
  for (std::size_t i = 0; i < out.distance.size(); ++i) {
    const std::string name = indexed("distance", i);
    const std::string sensor = "distance sensor " + std::to_string(i + 1);
    table.add(name + ".valid", kOutput, kDiscrete, kNone,
              "True if the last reading of " + sensor +
                  " found a surface within its range and the return path to the lens was free; false before "
                  "the first reading",
              out.distance[i].valid);
    table.add(
        name + ".value", kOutput, kDiscrete, kMetre,
        "Distance along the ray at the last reading of " + sensor + ", from its origin; 0 where invalid",
        out.distance[i].distance);
    table.bound(0);
    table.add(name + ".time", kOutput, kDiscrete, kSecond,
              "Simulation time of the last reading of " + sensor + "; 0 before the first reading",
              out.distance[i].time);
    table.mark_instant();
  }
  if (layout.collision_outputs) add_collision(table, layout, out.collision, dependencies.file);
}

}  // namespace robotcell::fmi
