// Parameters, and the initial values that depend on them.
#include "fmu/fmi/table_groups.h"
#include "fmu/model/description/value_limits.h"

namespace robotcell::fmi {
namespace {

void add_as_built_arm(TableBuilder& table, const CellLayout& layout, AsBuilt& as_built,
                      Dependencies& dependencies) {
  PoseDependencies before;
  before.position = before.orientation = dependencies.file;
  for (std::size_t i = 0; i < layout.joints.size(); ++i) {
    DhDeviation& dh = as_built.dh[i];
    const std::string row = indexed("dh", i);
    const std::string link = " of link " + std::to_string(i + 1) + " (Denavit-Hartenberg)";
    PoseDependencies after = before;
    const auto a = table.add_deviation(row + ".a", kMetre, "link length a" + link, dh.a);
    const auto d = table.add_deviation(row + ".d", kMetre, "link offset d" + link, dh.d);
    const auto alpha = table.add_deviation(row + ".alpha", kRadian, "link twist alpha" + link, dh.alpha);
    const auto theta =
        table.add_deviation(row + ".theta", kRadian, "zero offset of the joint angle theta" + link, dh.theta);
    after.add_length(a);
    after.add_length(d);
    after.add_angle(alpha);
    after.add_angle(theta);
    if (layout.joints[i].parallel_to_next) {
      const std::string axes = std::to_string(i + 1) + " and " + std::to_string(i + 2);
      after.add_angle(table.add_deviation(row + ".beta", kRadian,
                                          "rotation beta about y after the twist of link " +
                                              std::to_string(i + 1) +
                                              " (Hayati parameter): the tilt between the parallel axes " +
                                              axes + ", which Denavit-Hartenberg parameters cannot express",
                                          dh.beta));
    }
    // alpha and beta of a row rotate the link about its origin.
    dependencies.bodies.links.push_back({before.position, after.orientation, {}});
    Refs& position = dependencies.bodies.links.back().position;
    position.insert(position.end(), {a, d, theta});
    before = after;
  }
  dependencies.bodies.sensor = before;
  dependencies.bodies.fingers.assign(2, before);
}

/// Gravity deflects an arm with dynamic drives, and all rows of the geometry contribute.
void add_gravity_deflection(Dependencies& dependencies) {
  dependencies.true_axes = dependencies.bodies.sensor.orientation = dependencies.bodies.sensor.position;
  for (PoseDependencies& link : dependencies.bodies.links) {
    link.position = link.orientation = dependencies.true_axes;
  }
}

void add_as_built_tool(TableBuilder& table, AsBuilt& as_built, Dependencies& dependencies) {
  auto& tool = as_built.tool;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    dependencies.bodies.sensor.position.push_back(
        table.add_deviation("tool." + axis, kMetre,
                            "translation of the sensor along " + axis + " of its nominal frame", tool[i]));
  }
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    dependencies.bodies.sensor.orientation.push_back(table.add_deviation(
        "tool.r" + axis, kRadian,
        "rotation of the sensor about its " + axis + " axis (intrinsic, order x, y, z)", tool[3 + i]));
  }
}

void add_wobble(TableBuilder& table, TableWobble& wobble, PoseDependencies& platter) {
  platter.add_angle(table.add_deviation("table.wobble_amplitude", kRadian,
                                        "amplitude of the table wobble: at table angle t the table axis is "
                                        "tilted by amplitude * cos(t + phase)",
                                        wobble.amplitude));
  platter.add_angle(
      table.add_deviation("table.wobble_phase", kRadian, "phase of the table wobble", wobble.phase));
  platter.add_angle(table.add_deviation("table.wobble_direction", kRadian,
                                        "direction of the axis about which the table axis wobbles: angle "
                                        "from x in the table's nominal x-y plane",
                                        wobble.direction));
}

void add_as_built_table(TableBuilder& table, AsBuilt& as_built, Dependencies& dependencies) {
  PoseDependencies platter;
  platter.position = platter.orientation = dependencies.file;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    platter.add_length(table.add_deviation(
        "table." + axis, kMetre,
        "translation of the table axis along " + axis + " of the nominal table frame", as_built.table[i]));
  }
  for (std::size_t i = 0; i < 2; ++i) {
    const std::string axis = kAxisNames[i];
    platter.add_angle(table.add_deviation(
        "table.r" + axis, kRadian,
        "tilt of the table axis about " + axis + " of the nominal table frame (intrinsic, order x, y)",
        as_built.table[3 + i]));
  }
  for (std::size_t i = 0; i < 2; ++i) {
    const std::string axis = kAxisNames[i];
    platter.add_length(
        table.add_deviation("platter." + axis, kMetre,
                            "eccentricity: position of the platter centre from the table axis along " + axis +
                                " of the rotating frame",
                            as_built.platter[i]));
  }
  add_wobble(table, as_built.wobble, platter);
  dependencies.bodies.table = platter;
}

/// Parameters on which a displacement and its rate depend at the start.
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
  both.push_back(
      table.add_deviation(name + ".phase", kRadian, what + "phase of the sine at time 0", vibration.phase));
  both.push_back(
      table.add_deviation(name + ".random_rms", kMetre,
                          what + "root mean square displacement along each axis of the random part, a sum of "
                                 "sines in a frequency band that depends on the seed",
                          vibration.random_rms));
  table.bound(0, kMaxCoordinate);
  const auto low =
      table.add_deviation(name + ".random_low", kHertz,
                          what + "lower frequency of the band of the random part", vibration.random_low);
  const auto width = table.add_deviation(
      name + ".random_width", kHertz,
      what + "width of the frequency band of the random part; above 0 where random_rms is",
      vibration.random_width);
  both.push_back(seed);
  VibrationDependencies dependencies{both, both};
  dependencies.velocity.insert(dependencies.velocity.end(), {frequency, low, width});
  return dependencies;
}

void append(Refs& refs, const Refs& more) { refs.insert(refs.end(), more.begin(), more.end()); }

void add_vibration_dependencies(PoseDependencies& body, const VibrationDependencies& by) {
  append(body.position, by.position);
  append(body.velocity, by.velocity);
}

void add_vibrations(TableBuilder& table, AsBuilt& as_built, std::uint32_t seed, Dependencies& dependencies) {
  const auto base = add_vibration(table, "base", "the robot's base", as_built.base_vibration, seed);
  const auto flange = add_vibration(table, "flange", "the flange", as_built.flange_vibration, seed);
  const auto rotary = add_vibration(table, "table", "the table at angle 0", as_built.table_vibration, seed);
  BodiesDependencies& bodies = dependencies.bodies;
  for (PoseDependencies& link : bodies.links) {
    link.velocity = dependencies.file;
    add_vibration_dependencies(link, base);
  }
  std::vector<PoseDependencies*> tools{&bodies.sensor};
  for (PoseDependencies& finger : bodies.fingers) tools.push_back(&finger);
  for (PoseDependencies* tool : tools) {
    tool->velocity = dependencies.file;
    add_vibration_dependencies(*tool, base);
  }
  // The flange and the tools vibrate along the axes of the flange.
  const Refs axes = bodies.links.back().orientation;
  tools.push_back(&bodies.links.back());
  for (PoseDependencies* body : tools) {
    add_vibration_dependencies(*body, flange);
    append(body->position, axes);
    append(body->velocity, axes);
  }
  bodies.table.velocity = dependencies.file;
  add_vibration_dependencies(bodies.table, rotary);
}

}  // namespace

Dependencies add_parameters(TableBuilder& table, const CellLayout& layout, CellParameters& parameters) {
  Dependencies dependencies;
  const auto file = table.add("cell.file", Causality::kParameter, Variability::kFixed, kNone,
                              "Cell description (JSON in SI units): absolute path, or path relative to the "
                              "FMU's resources; its devices must match those of this FMU",
                              parameters.cell_file);
  const auto seed = table.add("seed", Causality::kParameter, Variability::kFixed, kNone,
                              "Random seed of all noise, combined with the seed in the cell description; "
                              "equal seeds give equal noise, independent of the communication step size",
                              parameters.seed);
  dependencies.file = {file};
  dependencies.measured = {file, seed};
  add_as_built_arm(table, layout, parameters.as_built, dependencies);
  dependencies.true_axes = dependencies.file;
  if (layout.dynamic_drives) add_gravity_deflection(dependencies);
  add_as_built_tool(table, parameters.as_built, dependencies);
  add_as_built_table(table, parameters.as_built, dependencies);
  add_vibrations(table, parameters.as_built, seed, dependencies);
  const PoseDependencies fixed{dependencies.file, dependencies.file, {}};
  for (const PartLayout& part : layout.parts) {
    dependencies.bodies.parts.push_back(part.on_table ? dependencies.bodies.table : fixed);
  }
  table.add_declared("as_built.trigger.", "the trigger", Causality::kParameter, parameters.as_built.trigger);
  if (layout.conveyors > 0) {
    table.add_declared("as_built.belt.", "all belts", Causality::kParameter, parameters.as_built.belt);
  }
  return dependencies;
}

}  // namespace robotcell::fmi
