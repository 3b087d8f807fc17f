// Parameters, and which initial values depend on them.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

void add_as_built_arm(TableBuilder& table, AsBuilt& as_built, Dependencies& known) {
  PoseDependencies before;
  before.position = before.orientation = known.file;
  for (std::size_t i = 0; i < kJoints; ++i) {
    DhDeviation& dh = as_built.dh[i];
    const std::string row = indexed("dh", i);
    const std::string link = " of link " + std::to_string(i + 1) + " (Denavit-Hartenberg)";
    PoseDependencies after = before;
    const auto a = table.add_deviation(row + ".a", kMetre, "length a" + link, dh.a);
    const auto d = table.add_deviation(row + ".d", kMetre, "offset d" + link, dh.d);
    const auto alpha = table.add_deviation(row + ".alpha", kRadian, "twist alpha" + link, dh.alpha);
    const auto theta =
        table.add_deviation(row + ".theta", kRadian, "zero of the joint angle theta" + link, dh.theta);
    after.add_length(a);
    after.add_length(d);
    after.add_angle(alpha);
    after.add_angle(theta);
    if (i == 1) {
      after.add_angle(table.add_deviation(
          row + ".beta", kRadian,
          "turn about y after the twist of link 2 (Hayati), the tilt between the parallel "
          "axes 2 and 3 that no Denavit-Hartenberg number expresses",
          dh.beta));
    }
    // The row's own twists turn the link about its origin.
    known.bodies.links[i] = {before.position, after.orientation, {}};
    Refs& position = known.bodies.links[i].position;
    position.insert(position.end(), {a, d, theta});
    before = after;
  }
  known.bodies.sensor = before;
  known.bodies.fingers.assign(2, before);
}

/// Gravity bends a compliant arm, and all rows of its geometry decide how.
void sag(Dependencies& known) {
  known.true_axes = known.bodies.sensor.orientation = known.bodies.sensor.position;
  for (PoseDependencies& link : known.bodies.links) link.position = link.orientation = known.true_axes;
}

void add_as_built_tool(TableBuilder& table, AsBuilt& as_built, Dependencies& known) {
  auto& tool = as_built.tool;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    known.bodies.sensor.position.push_back(table.add_deviation(
        "tool." + axis, kMetre, "shift of the sensor along its nominal " + axis, tool[i]));
  }
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    known.bodies.sensor.orientation.push_back(table.add_deviation(
        "tool.r" + axis, kRadian,
        "turn of the sensor about its " + axis + " (intrinsic, in the order x, y, z)", tool[3 + i]));
  }
}

void add_wobble(TableBuilder& table, TableWobble& wobble, PoseDependencies& platter) {
  platter.add_angle(table.add_deviation(
      "table.wobble_amplitude", kRadian,
      "amplitude of the table's wobble: at angle t, its axis is tilted by amplitude * cos(t + phase)",
      wobble.amplitude));
  platter.add_angle(
      table.add_deviation("table.wobble_phase", kRadian, "phase of the table's wobble", wobble.phase));
  platter.add_angle(table.add_deviation(
      "table.wobble_direction", kRadian,
      "angle in the table's x-y plane, from x, of the axis about which the table's axis wobbles",
      wobble.direction));
}

void add_as_built_table(TableBuilder& table, AsBuilt& as_built, Dependencies& known) {
  PoseDependencies platter;
  platter.position = platter.orientation = known.file;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    platter.add_length(table.add_deviation("table." + axis, kMetre,
                                           "shift of the table's axis along the table's nominal " + axis,
                                           as_built.table[i]));
  }
  for (std::size_t i = 0; i < 2; ++i) {
    const std::string axis = kAxisNames[i];
    platter.add_angle(table.add_deviation(
        "table.r" + axis, kRadian,
        "tilt of the table's axis about the table's " + axis + " (intrinsic, in the order x, y)",
        as_built.table[3 + i]));
  }
  for (std::size_t i = 0; i < 2; ++i) {
    const std::string axis = kAxisNames[i];
    platter.add_length(table.add_deviation(
        "platter." + axis, kMetre,
        "distance of the platter's centre from the table's axis along " + axis + " of the turning frame",
        as_built.platter[i]));
  }
  add_wobble(table, as_built.wobble, platter);
  known.bodies.table = platter;
}

/// The parameters on which a displacement and its rate depend at the start.
struct VibrationDependencies {
  Refs position, velocity;
};

VibrationDependencies add_vibration(TableBuilder& table, const std::string& place, const std::string& axes,
                                    VibrationParameters& vibration, std::uint32_t seed) {
  const std::string name = "vibration." + place;
  const std::string what = "vibration of the " + place + ": ";
  Refs both;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    both.push_back(table.add_deviation(name + "." + axis, kMetre,
                                       what + "amplitude of a sine along " + axis + " of " + axes,
                                       vibration.amplitude[i]));
  }
  const auto frequency =
      table.add_deviation(name + ".frequency", kHertz, what + "frequency of the sine", vibration.frequency);
  both.push_back(table.add_deviation(name + ".phase", kRadian, what + "phase of the sine at the start",
                                     vibration.phase));
  both.push_back(table.add_deviation(name + ".random_rms", kMetre,
                                     what + "root mean square, along each axis, of a random part: a sum of "
                                            "sines, evenly spread over a band of frequencies, by the seed",
                                     vibration.random_rms));
  const auto low =
      table.add_deviation(name + ".random_low", kHertz, what + "where the band starts", vibration.random_low);
  const auto width =
      table.add_deviation(name + ".random_width", kHertz, what + "width of the band", vibration.random_width);
  both.push_back(seed);
  VibrationDependencies known{both, both};
  known.velocity.insert(known.velocity.end(), {frequency, low, width});
  return known;
}

void append(Refs& refs, const Refs& more) { refs.insert(refs.end(), more.begin(), more.end()); }

void shake(PoseDependencies& body, const VibrationDependencies& by) {
  append(body.position, by.position);
  append(body.velocity, by.velocity);
}

void add_vibrations(TableBuilder& table, AsBuilt& as_built, std::uint32_t seed, Dependencies& known) {
  const auto base = add_vibration(table, "base", "the robot's base", as_built.base_vibration, seed);
  const auto flange = add_vibration(table, "flange", "the flange", as_built.flange_vibration, seed);
  const auto rotary = add_vibration(table, "table", "the table at angle 0", as_built.table_vibration, seed);
  BodiesDependencies& bodies = known.bodies;
  for (PoseDependencies& link : bodies.links) {
    link.velocity = known.file;
    shake(link, base);
  }
  std::vector<PoseDependencies*> tools{&bodies.sensor};
  for (PoseDependencies& finger : bodies.fingers) tools.push_back(&finger);
  for (PoseDependencies* tool : tools) {
    tool->velocity = known.file;
    shake(*tool, base);
  }
  // The flange shakes along its own axes, and the tools with it.
  const Refs axes = bodies.links.back().orientation;
  tools.push_back(&bodies.links.back());
  for (PoseDependencies* body : tools) {
    shake(*body, flange);
    append(body->position, axes);
    append(body->velocity, axes);
  }
  bodies.table.velocity = known.file;
  shake(bodies.table, rotary);
}

}  // namespace

Dependencies add_parameters(TableBuilder& table, const CellLayout& layout, CellParameters& parameters) {
  Dependencies known;
  const auto file = table.add(
      "cell.file", Causality::kParameter, Variability::kFixed, kNone,
      "Description of the cell (JSON in SI units): an absolute path, or one relative to the FMU's resources",
      parameters.cell_file);
  const auto seed = table.add(
      "seed", Causality::kParameter, Variability::kFixed, kNone,
      "Seed of all random numbers, together with the seed in the cell's description; the same seeds give the "
      "same noise at any communication step",
      parameters.seed);
  known.file = {file};
  known.measured = {file, seed};
  add_as_built_arm(table, parameters.as_built, known);
  known.true_axes = known.file;
  if (layout.dynamic_drives) sag(known);
  add_as_built_tool(table, parameters.as_built, known);
  add_as_built_table(table, parameters.as_built, known);
  add_vibrations(table, parameters.as_built, seed, known);
  const PoseDependencies standing{known.file, known.file, {}};
  for (const PartLayout& part : layout.parts) {
    known.bodies.parts.push_back(part.on_table ? known.bodies.table : standing);
  }
  table.add_deviation("trigger.latency", kSecond,
                      "time by which the light of an exposure comes after the instant at which its "
                      "measurements are latched",
                      parameters.as_built.trigger.latency);
  table.add_deviation(
      "trigger.jitter", kSecond,
      "standard deviation by which that time varies from exposure to exposure, by the seed; the "
      "light never comes before the instant of firing",
      parameters.as_built.trigger.jitter);
  return known;
}

}  // namespace robotcell::fmi
