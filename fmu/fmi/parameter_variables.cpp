// Parameters, and the initial values that depend on them.
#include "fmu/fmi/table_groups.h"
#include "fmu/model/description/value_limits.h"

namespace robotcell::fmi {
namespace {

/// Parameters of a Denavit-Hartenberg row: those that displace the frame of the link, and that turn it. alpha
/// and beta turn it about its origin.
struct RowRefs {
  Refs displacing, turning;
};

RowRefs add_row(TableBuilder& table, const CellLayout& layout, std::size_t i, DhDeviation& dh) {
  const std::string row = indexed("dh", i);
  const std::string link = " of link " + std::to_string(i + 1) + " (Denavit-Hartenberg)";
  const auto a = table.add_deviation(row + ".a", kMetre, "link length a" + link, dh.a);
  const auto d = table.add_deviation(row + ".d", kMetre, "link offset d" + link, dh.d);
  const auto alpha = table.add_deviation(row + ".alpha", kRadian, "link twist alpha" + link, dh.alpha);
  const auto theta =
      table.add_deviation(row + ".theta", kRadian, "zero offset of the joint angle theta" + link, dh.theta);
  RowRefs refs{{a, d, theta}, {alpha, theta}};
  if (layout.joints[i].parallel_to_next) {
    const std::string axes = std::to_string(i + 1) + " and " + std::to_string(i + 2);
    refs.turning.push_back(
        table.add_deviation(row + ".beta", kRadian,
                            "rotation beta about y after the twist of link " + std::to_string(i + 1) +
                                " (Hayati parameter): the tilt between the parallel axes " + axes +
                                ", which Denavit-Hartenberg parameters cannot express",
                            dh.beta));
  }
  return refs;
}

/// Parameters that displace a frame in front of its joint, that turn it there, and that displace it behind.
struct FrameRefs {
  Refs displacing, turning, behind;
};

/// Deviation of a frame by all six coordinates.
FrameRefs add_as_built_frame(TableBuilder& table, const std::string& name, const std::string& what,
                             std::array<double, 6>& by) {
  FrameRefs refs;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    refs.displacing.push_back(
        table.add_deviation(name + "." + axis, kMetre,
                            "translation of " + what + " along " + axis + " of its nominal frame", by[i]));
  }
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    refs.turning.push_back(table.add_deviation(
        name + ".r" + axis, kRadian,
        "rotation of " + what + " about its " + axis + " axis (intrinsic, order x, y, z)", by[3 + i]));
  }
  return refs;
}

FrameRefs add_as_built_table(TableBuilder& table, AsBuilt& as_built) {
  FrameRefs refs;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    refs.displacing.push_back(table.add_deviation(
        "table." + axis, kMetre,
        "translation of the table axis along " + axis + " of the nominal table frame", as_built.table[i]));
  }
  for (std::size_t i = 0; i < 2; ++i) {
    const std::string axis = kAxisNames[i];
    refs.turning.push_back(table.add_deviation(
        "table.r" + axis, kRadian,
        "tilt of the table axis about " + axis + " of the nominal table frame (intrinsic, order x, y)",
        as_built.table[3 + i]));
  }
  for (std::size_t i = 0; i < 2; ++i) {
    const std::string axis = kAxisNames[i];
    refs.behind.push_back(
        table.add_deviation("platter." + axis, kMetre,
                            "eccentricity: position of the platter centre from the table axis along " + axis +
                                " of the rotating frame",
                            as_built.platter[i]));
  }
  TableWobble& wobble = as_built.wobble;
  refs.turning.push_back(table.add_deviation("table.wobble_amplitude", kRadian,
                                             "amplitude of the table wobble: at table angle t the table axis "
                                             "is tilted by amplitude * cos(t + phase)",
                                             wobble.amplitude));
  refs.turning.push_back(
      table.add_deviation("table.wobble_phase", kRadian, "phase of the table wobble", wobble.phase));
  refs.turning.push_back(
      table.add_deviation("table.wobble_direction", kRadian,
                          "direction of the axis about which the table axis wobbles: angle from x in the "
                          "table's nominal x-y plane",
                          wobble.direction));
  return refs;
}

/// Parameters on which a displacement and its rate depend at the start.
struct VibrationRefs {
  Refs position, velocity;
};

VibrationRefs add_vibration(TableBuilder& table, const std::string& place, const std::string& axes,
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
  VibrationRefs refs{both, both};
  refs.velocity.insert(refs.velocity.end(), {frequency, low, width});
  return refs;
}

void append(Refs& refs, const Refs& more) { refs.insert(refs.end(), more.begin(), more.end()); }

/// What a frame depends on that is fixed to another one off its origin, or a body on it.
PoseDependencies carried_by(const PoseDependencies& frame) {
  PoseDependencies carried = frame;
  append(carried.position, frame.orientation);
  return carried;
}

PoseDependencies with(PoseDependencies frame, const Refs& displacing, const Refs& turning) {
  append(frame.position, displacing);
  append(frame.orientation, turning);
  return frame;
}

/// A frame that vibrates along its own axes.
PoseDependencies with(PoseDependencies frame, const VibrationRefs& vibration) {
  append(frame.position, vibration.position);
  append(frame.velocity, vibration.velocity);
  append(frame.velocity, frame.orientation);
  return frame;
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
  AsBuilt& as_built = parameters.as_built;
  std::vector<RowRefs> rows;
  for (std::size_t i = 0; i < layout.joints.size(); ++i) {
    rows.push_back(add_row(table, layout, i, as_built.dh[i]));
  }
  std::vector<FrameRefs> axes;
  for (std::size_t i = 0; i < layout.axes.size(); ++i) {
    const std::string& name = layout.axes[i].name;
    axes.push_back(add_as_built_frame(table, "axis." + name, "the axis " + name, as_built.axes[i]));
  }
  const FrameRefs tool = add_as_built_frame(table, "tool", "the sensor", as_built.tool);
  std::vector<FrameRefs> further_sensors;
  for (std::size_t i = 0; i < layout.further_sensors.size(); ++i) {
    const std::string number = std::to_string(i + 2);
    further_sensors.push_back(
        add_as_built_frame(table, "sensor[" + number + "]", "sensor " + number, as_built.further_sensors[i]));
  }
  const FrameRefs grasp = holds_part(layout)
                              ? add_as_built_frame(table, "grasp", "the part on the flange", as_built.grasp)
                              : FrameRefs{};
  const FrameRefs table_refs = add_as_built_table(table, as_built);
  const VibrationRefs of_base =
      add_vibration(table, "base", "the robot's base", as_built.base_vibration, seed);
  const VibrationRefs of_flange =
      add_vibration(table, "flange", "the flange", as_built.flange_vibration, seed);
  const VibrationRefs of_table =
      add_vibration(table, "table", "the table at angle 0", as_built.table_vibration, seed);

  // From the world to each frame, by number.
  const PoseDependencies at_rest{dependencies.file, dependencies.file, dependencies.file};
  dependencies.true_axes = dependencies.file;
  if (layout.dynamic_drives) {  // gravity deflects the joints, and all rows contribute
    for (const RowRefs& row : rows) {
      append(dependencies.true_axes, row.displacing);
      append(dependencies.true_axes, row.turning);
    }
  }
  const FrameNumbers numbers = layout.frames();
  std::vector<PoseDependencies> frames{{dependencies.file, dependencies.file, {}}};
  const auto standing_on = [&](std::size_t frame) {
    return frame == kWorld ? at_rest : carried_by(frames[frame]);
  };
  for (std::size_t i = 0; i < layout.axes.size(); ++i) {
    frames.push_back(with(standing_on(layout.axes[i].moves_with), axes[i].displacing, axes[i].turning));
  }
  frames.push_back(with(standing_on(layout.robot_moves_with), of_base));
  for (const RowRefs& row : rows) {
    frames.push_back(with(with(carried_by(frames.back()), row.displacing, row.turning),
                          dependencies.true_axes, dependencies.true_axes));
  }
  frames.push_back(with(carried_by(frames.back()), of_flange));
  const PoseDependencies& flange = frames.back();
  frames.push_back(with(layout.sensor_moves_with ? standing_on(*layout.sensor_moves_with) : flange,
                        tool.displacing, tool.turning));
  frames.push_back(
      with(with(standing_on(layout.table_moves_with), of_table), table_refs.displacing, table_refs.turning));
  frames.push_back(with(carried_by(frames.back()), table_refs.behind, {}));
  for (std::size_t i = 0; i < layout.further_sensors.size(); ++i) {
    const FrameRefs& refs = further_sensors[i];
    frames.push_back(with(carried_by(frames[layout.further_sensors[i]]), refs.displacing, refs.turning));
  }
  BodiesDependencies& bodies = dependencies.bodies;
  for (std::size_t i = 0; i < numbers.axes; ++i) bodies.axes.push_back(frames[numbers.axis(i)]);
  for (std::size_t i = 0; i < numbers.joints; ++i) bodies.links.push_back(frames[numbers.link(i)]);
  bodies.sensor = frames[numbers.sensor()];
  bodies.table = frames[numbers.platter()];
  bodies.fingers.assign(2, frames[numbers.flange()]);
  for (std::size_t i = 0; i < numbers.further_sensors; ++i) {
    bodies.further_sensors.push_back(frames[numbers.further_sensor(i)]);
  }
  for (const std::size_t frame : layout.parts) bodies.parts.push_back(carried_by(frames[frame]));
  if (holds_part(layout)) bodies.parts.front() = with(bodies.parts.front(), grasp.displacing, grasp.turning);
  table.add_declared("as_built.trigger.", "the trigger", Causality::kParameter, parameters.as_built.trigger);
  if (layout.conveyors > 0) {
    table.add_declared("as_built.belt.", "all belts", Causality::kParameter, parameters.as_built.belt);
  }
  return dependencies;
}

}  // namespace robotcell::fmi
