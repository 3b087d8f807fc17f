// Outputs of presence sensors, distance sensors and the collision watch.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

constexpr auto kOutput = Causality::kOutput;
constexpr auto kDiscrete = Variability::kDiscrete;

void add_collision(TableBuilder& table, const CellLayout& layout, CollisionReading& reading,
                   const Refs& file) {
  const std::string prefix = "truth.collision.";
  std::string names = ", as a number: 0 none";
  for (std::size_t i = 0; i < layout.bodies.size(); ++i) {
    names += ", " + std::to_string(i + 1) + " " + layout.bodies[i];
  }
  const std::string when = ", at the last cycle of the controller";
  table.add(prefix + "pairs", kOutput, kDiscrete, kNone,
            "Number of watched pairs of bodies whose surfaces intersect" + when, reading.pairs);
  table.add(prefix + "body_a", kOutput, kDiscrete, kNone, "First body of the deepest collision" + names,
            reading.body_a);
  table.add(prefix + "body_b", kOutput, kDiscrete, kNone, "Second body of the deepest collision" + names,
            reading.body_b);
  table.add(prefix + "depth", kOutput, kDiscrete, kMetre,
            "Depth of the deepest collision, along the normal of the face that is met" + when, reading.depth);
  for (std::size_t i = 0; i < 3; ++i) {
    table.add(indexed(prefix + "point", i), kOutput, kDiscrete, kMetre,
              std::string("Point of the deepest collision, world ") + kAxisNames[i], reading.point[i]);
  }
  const std::string near = "truth.clearance.";
  table.add(near + "distance", kOutput, kDiscrete, kMetre,
            "Smallest distance between two watched bodies, 0 where any collide; never more than the range of "
            "the watch" +
                when,
            reading.clearance, file);
  table.add(near + "body_a", kOutput, kDiscrete, kNone, "First body of the nearest pair" + names,
            reading.near_a);
  table.add(near + "body_b", kOutput, kDiscrete, kNone, "Second body of the nearest pair" + names,
            reading.near_b);
}

}  // namespace

void add_sensing(TableBuilder& table, const CellLayout& layout, CellOutputs& out, const Dependencies& known) {
  for (std::size_t i = 0; i < out.presence.size(); ++i) {
    table.add(indexed("presence", i) + ".detected", kOutput, kDiscrete, kNone,
              "Whether any part reached into the volume of presence sensor " + std::to_string(i + 1) +
                  " at its last reading; false before the first",
              out.presence[i].detected);
  }
  for (std::size_t i = 0; i < out.distance.size(); ++i) {
    const std::string name = indexed("distance", i);
    const std::string sensor = "distance sensor " + std::to_string(i + 1);
    table.add(
        name + ".valid", kOutput, kDiscrete, kNone,
        "Whether the last reading of " + sensor +
            " found a surface in its range, and nothing between that and the lens; false before the first",
        out.distance[i].valid);
    table.add(name + ".value", kOutput, kDiscrete, kMetre,
              "Distance that " + sensor + " read last, along its ray; 0 where it is not valid",
              out.distance[i].distance);
    table.add(name + ".time", kOutput, kDiscrete, kSecond, "Instant of the last reading of " + sensor,
              out.distance[i].time);
  }
  if (layout.collision_outputs) add_collision(table, layout, out.collision, known.file);
}

}  // namespace robotcell::fmi
