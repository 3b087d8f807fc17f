#include "fmu/fmi/variable_table.h"

#include <cstdio>

#include "fmu/fmi/table_builder.h"

namespace robotcell::fmi {
namespace {

/// What initial values depend on.
struct Dependencies {
  Refs file, measured;
  BodyDependencies bodies;
};

void add_as_built_arm(TableBuilder& table, Dependencies& known) {
  PoseDependencies before;
  before.position = before.orientation = known.file;
  for (std::size_t i = 0; i < kJoints; ++i) {
    DhDeviation& dh = table.values.parameters.as_built.dh[i];
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
    known.bodies[i] = {before.position, after.orientation};
    known.bodies[i].position.insert(known.bodies[i].position.end(), {a, d, theta});
    before = after;
  }
  known.bodies[kSensor] = before;
}

void add_as_built_tool(TableBuilder& table, Dependencies& known) {
  auto& tool = table.values.parameters.as_built.tool;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    known.bodies[kSensor].position.push_back(table.add_deviation(
        "tool." + axis, kMetre, "shift of the sensor along its nominal " + axis, tool[i]));
  }
  for (std::size_t i = 0; i < 3; ++i) {
    const std::string axis = kAxisNames[i];
    known.bodies[kSensor].orientation.push_back(table.add_deviation(
        "tool.r" + axis, kRadian,
        "turn of the sensor about its " + axis + " (intrinsic, in the order x, y, z)", tool[3 + i]));
  }
}

void add_as_built_table(TableBuilder& table, Dependencies& known) {
  AsBuilt& as_built = table.values.parameters.as_built;
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
  known.bodies[kTable] = known.bodies[kPart] = platter;
}

Dependencies add_parameters(TableBuilder& table) {
  Dependencies known;
  CellParameters& parameters = table.values.parameters;
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
  add_as_built_arm(table, known);
  add_as_built_tool(table, known);
  add_as_built_table(table, known);
  table.add_deviation("trigger.latency", kSecond,
                      "time by which the light of an exposure comes after the instant at which its "
                      "measurements are latched",
                      parameters.as_built.trigger_latency);
  return known;
}

void add_set_points(TableBuilder& table) {
  const auto input = Causality::kInput;
  const auto discrete = Variability::kDiscrete;
  CellInputs& in = table.values.inputs;
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

void add_trigger_commands(TableBuilder& table) {
  const auto input = Causality::kInput;
  const auto discrete = Variability::kDiscrete;
  CellInputs& in = table.values.inputs;
  table.add("command.trigger.mode", input, discrete, kNone,
            "What fires the sensor: 0 nothing, 1 time, 2 angle of the table, 3 path of the sensor over the "
            "table, 4 requests alone; a mode counts from the instant at which it is entered (or its interval "
            "changed) and fires there first",
            in.trigger.mode);
  table.limit_integer(0, 4);
  table.add("command.trigger.period", input, discrete, kSecond, "Time between two exposures in mode 1",
            in.trigger.period);
  table.add("command.trigger.angle", input, discrete, kRadian,
            "Angle of the table between two exposures in mode 2", in.trigger.angle);
  table.add("command.trigger.distance", input, discrete, kMetre,
            "Path of the sensor's origin, as seen from the turning table, between two exposures in mode 3",
            in.trigger.distance);
  table.add("command.trigger.request", input, discrete, kNone,
            "Every increase fires the sensor once, in any mode but 0", in.trigger.request);
  table.add("command.exposure", input, discrete, kSecond, "Duration of the exposures that fire from now on",
            in.exposure);
}

void add_truth(TableBuilder& table, const Dependencies& known) {
  const auto output = Causality::kOutput;
  const auto continuous = Variability::kContinuous;
  Truth& truth = table.values.outputs.truth;
  for (std::size_t i = 0; i < kJoints; ++i) {
    table.add(indexed("truth.q", i), output, continuous, kRadian,
              "True angle of joint " + std::to_string(i + 1) +
                  " at its drive; the zero error of the arm as built comes on top",
              truth.position[i], known.file);
  }
  table.add("truth.table", output, continuous, kRadian, "True angle of the table, not wrapped",
            truth.position[kTableAxis], known.file);
  table.add_bodies("truth.", "", continuous, truth.bodies, known.bodies);
}

void add_record(TableBuilder& table) {
  const auto output = Causality::kOutput;
  const auto discrete = Variability::kDiscrete;
  CellOutputs& out = table.values.outputs;
  TriggerRecord& record = out.trigger;
  table.add("trigger.count", output, discrete, kNone, "Exposures fired so far", out.trigger_count);
  table.add("trigger.index", output, discrete, kNone,
            "Number of the exposure whose record is on display, counted from 1; 0 before the first. Every "
            "communication step displays the next finished record, if there is one",
            record.index);
  table.add("trigger.queued", output, discrete, kNone, "Finished records that wait for their display",
            out.trigger_queued);
  table.add("trigger.time", output, discrete, kSecond, "Middle of the exposure on display", record.time);
  table.add("trigger.exposure", output, discrete, kSecond, "Duration of the exposure on display",
            record.exposure);
  table.add("trigger.segment", output, discrete, kNone, "Path segment in which the exposure on display fired",
            record.segment);
  table.add_measurement("trigger.measured.", ", latched in the middle of the exposure on display",
                        record.measured, {});
  table.add_bodies("trigger.truth.", ", when the light of the exposure on display came", discrete,
                   record.truth, {});
}

std::vector<Variable> make_table() {
  TableBuilder table;
  table.add("time", Causality::kIndependent, Variability::kContinuous, kSecond, "Simulation time",
            table.values.time);
  const Dependencies known = add_parameters(table);
  add_set_points(table);
  add_trigger_commands(table);
  table.add_measurement("measured.", "", table.values.outputs.measured, known.measured);
  add_truth(table, known);
  add_record(table);
  table.add("controller.moving", Causality::kOutput, Variability::kDiscrete, kNone,
            "Whether any axis is in motion", table.values.outputs.moving);
  table.add(
      "controller.limit", Causality::kOutput, Variability::kDiscrete, kNone,
      "First axis that a position or speed limit keeps from its set-point: 1 to 6 joint, 7 table, 0 none",
      table.values.outputs.limit);
  return table.take();
}

/// FNV-1a over what an importer relies on: order, names, types and causalities.
std::string make_token() {
  std::uint64_t low = 0xcbf29ce484222325u;
  std::uint64_t high = 0x84222325cbf29ce4u;
  const auto feed = [&low, &high](unsigned char byte) {
    low = (low ^ byte) * 0x100000001b3u;
    high = (high ^ (low >> 32)) * 0x100000001b3u;
  };
  for (const Variable& variable : variables()) {
    for (const char c : variable.name) feed(static_cast<unsigned char>(c));
    feed(static_cast<unsigned char>(variable.type));
    feed(static_cast<unsigned char>(variable.causality));
  }
  char text[40];
  std::snprintf(text, sizeof text, "{%08x-%04x-%04x-%04x-%012llx}", static_cast<unsigned>(high >> 32),
                static_cast<unsigned>(high >> 16 & 0xffff), static_cast<unsigned>(high & 0xffff),
                static_cast<unsigned>(low >> 48), static_cast<unsigned long long>(low & 0xffffffffffffu));
  return text;
}

}  // namespace

const std::vector<Variable>& variables() {
  static const std::vector<Variable> table = make_table();
  return table;
}

const std::string& instantiation_token() {
  static const std::string token = make_token();
  return token;
}

}  // namespace robotcell::fmi
