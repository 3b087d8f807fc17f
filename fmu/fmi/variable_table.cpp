#include "fmu/fmi/variable_table.h"

#include <cstdio>
#include <initializer_list>
#include <type_traits>
#include <utility>

namespace robotcell::fmi {
namespace {

constexpr Unit kNone{"", ""};
constexpr Unit kSecond{"s", "ms"};
constexpr Unit kMetre{"m", "mm"};
constexpr Unit kRadian{"rad", "deg"};
constexpr Unit kMetrePerSecond{"m/s", "mm/s"};
constexpr Unit kRadianPerSecond{"rad/s", "deg/s"};
constexpr const char* kAxisNames[] = {"x", "y", "z"};
constexpr const char* kQuaternionNames[] = {"w", "x", "y", "z"};

std::string indexed(const std::string& name, std::size_t index_from_0) {
  return name + "[" + std::to_string(index_from_0 + 1) + "]";
}

/// Groups of parameters that initial values depend on.
struct ParameterGroups {
  std::vector<std::uint32_t> file, seed, links[kJoints], tool, table, platter;
};

class TableBuilder {
 public:
  std::vector<Variable> build();

 private:
  using Refs = std::vector<std::uint32_t>;

  template <class T>
  std::uint32_t add(const std::string& name, Causality causality, Variability variability, Unit unit,
                    const std::string& description, T& where, const Refs& dependencies = {});
  void parameters();
  void as_built_arm();
  void as_built_rest();
  void command();
  void measurement(const std::string& prefix, const std::string& when, Measurement& where, bool live);
  void body(const std::string& prefix, const std::string& what, const std::string& when, BodyState& where,
            const Refs& dependencies);
  void bodies(const std::string& prefix, const std::string& when, Bodies& where, bool live);
  void record();
  void limit_integer(std::int32_t min, std::int32_t max) {
    table_.back().min = min;
    table_.back().max = max;
  }

  Values values_;
  ParameterGroups groups_;
  std::vector<Variable> table_;
};

template <class T>
constexpr Type type_of() {
  if constexpr (std::is_same_v<T, double>) return Type::kReal;
  if constexpr (std::is_same_v<T, std::int32_t>) return Type::kInteger;
  if constexpr (std::is_same_v<T, bool>) return Type::kBoolean;
  return Type::kString;
}

template <class T>
std::uint32_t TableBuilder::add(const std::string& name, Causality causality, Variability variability,
                                Unit unit, const std::string& description, T& where,
                                const Refs& dependencies) {
  const auto offset =
      static_cast<std::size_t>(reinterpret_cast<char*>(&where) - reinterpret_cast<char*>(&values_));
  table_.push_back(
      {name, type_of<T>(), causality, variability, unit, description, offset, 0, 0, dependencies});
  return static_cast<std::uint32_t>(table_.size() - 1);
}

std::vector<std::uint32_t> together(std::initializer_list<std::vector<std::uint32_t>> groups) {
  std::vector<std::uint32_t> all;
  for (const auto& group : groups) all.insert(all.end(), group.begin(), group.end());
  return all;
}

void TableBuilder::parameters() {
  const auto fixed = Variability::kFixed;
  const auto parameter = Causality::kParameter;
  auto& p = values_.parameters;
  groups_.file = {
      add("cell.file", parameter, fixed, kNone,
          "Description of the cell (JSON in SI units): an absolute path, or one relative to the FMU's "
          "resources; empty: cell.json in the resources",
          p.cell_file)};
  groups_.seed = {
      add("seed", parameter, fixed, kNone,
          "Seed of all random numbers, together with the seed in the cell's description; the same seeds "
          "give the same noise at any communication step",
          p.seed)};
  as_built_arm();
  as_built_rest();
}

void TableBuilder::as_built_arm() {
  const auto add_deviation = [this](const std::string& name, Unit unit, const std::string& text,
                                    double& where) {
    return add("as_built." + name, Causality::kParameter, Variability::kFixed, unit,
               "Deviation of the cell as built from its description: " + text, where);
  };
  Refs so_far = groups_.file;
  for (std::size_t i = 0; i < kJoints; ++i) {
    DhDeviation& dh = values_.parameters.as_built.dh[i];
    const std::string row = indexed("dh", i);
    const std::string link = " of link " + std::to_string(i + 1) + " (Denavit-Hartenberg)";
    so_far.push_back(add_deviation(row + ".a", kMetre, "length a" + link, dh.a));
    so_far.push_back(add_deviation(row + ".d", kMetre, "offset d" + link, dh.d));
    so_far.push_back(add_deviation(row + ".alpha", kRadian, "twist alpha" + link, dh.alpha));
    so_far.push_back(
        add_deviation(row + ".theta", kRadian, "zero of the joint angle theta" + link, dh.theta));
    if (i == 1) {
      so_far.push_back(
          add_deviation(row + ".beta", kRadian,
                        "turn about y after the twist of link 2 (Hayati), the tilt between the parallel "
                        "axes 2 and 3 that no Denavit-Hartenberg number expresses",
                        dh.beta));
    }
    groups_.links[i] = so_far;
  }
}

void TableBuilder::as_built_rest() {
  const auto add_deviation = [this](const std::string& name, Unit unit, const std::string& text,
                                    double& where) {
    return add("as_built." + name, Causality::kParameter, Variability::kFixed, unit,
               "Deviation of the cell as built from its description: " + text, where);
  };
  AsBuilt& as_built = values_.parameters.as_built;
  groups_.tool = groups_.links[kJoints - 1];
  groups_.table = groups_.file;
  for (std::size_t i = 0; i < 6; ++i) {
    const std::string axis = kAxisNames[i % 3];
    groups_.tool.push_back(
        i < 3 ? add_deviation("tool." + axis, kMetre, "shift of the sensor along its own " + axis,
                              as_built.tool[i])
              : add_deviation("tool.r" + axis, kRadian,
                              "turn of the sensor about its " + axis + " (intrinsic x, y, z order)",
                              as_built.tool[i]));
  }
  for (std::size_t i = 0; i < 5; ++i) {
    const std::string axis = kAxisNames[i % 3];
    groups_.table.push_back(
        i < 3 ? add_deviation("table." + axis, kMetre, "shift of the table's axis along the table's " + axis,
                              as_built.table[i])
              : add_deviation("table.r" + axis, kRadian, "tilt of the table's axis about the table's " + axis,
                              as_built.table[i]));
  }
  groups_.platter = groups_.table;
  for (std::size_t i = 0; i < 2; ++i) {
    const std::string axis = kAxisNames[i];
    groups_.platter.push_back(add_deviation(
        "platter." + axis, kMetre,
        "distance of the platter's centre from the table's axis along " + axis + " of the turning frame",
        as_built.platter[i]));
  }
  add_deviation(
      "trigger.latency", kSecond,
      "time by which the light of an exposure comes after the instant that the trigger device latches",
      as_built.trigger_latency);
}

void TableBuilder::command() {
  const auto input = Causality::kInput;
  const auto discrete = Variability::kDiscrete;
  CellInputs& in = values_.inputs;
  add("command.mode", input, discrete, kNone,
      "What the controller does: 0 brake and hold, 1 follow the set-points", in.mode);
  limit_integer(0, 1);
  for (std::size_t i = 0; i < kJoints; ++i) {
    add(indexed("command.q", i), input, discrete, kRadian,
        "Set-point of joint " + std::to_string(i + 1) +
            "; the controller takes it at its next cycle and reaches it one cycle later",
        in.position[i]);
  }
  add("command.table", input, discrete, kRadian,
      "Set-point of the rotary table; the controller takes it at its next cycle and reaches it one cycle "
      "later",
      in.position[kTableAxis]);
  add("command.segment", input, discrete, kNone,
      "Number of the path segment, handed through to the trigger records", in.segment);
  add("command.trigger.mode", input, discrete, kNone,
      "What fires the sensor: 0 nothing, 1 time, 2 angle of the table, 3 path of the sensor over the table, "
      "4 requests "
      "alone; a mode counts from the instant at which it is entered and fires there first",
      in.trigger.mode);
  limit_integer(0, 4);
  add("command.trigger.period", input, discrete, kSecond, "Time between two exposures in mode 1",
      in.trigger.period);
  add("command.trigger.angle", input, discrete, kRadian, "Angle of the table between two exposures in mode 2",
      in.trigger.angle);
  add("command.trigger.distance", input, discrete, kMetre,
      "Path of the sensor's origin, as seen from the turning table, between two exposures in mode 3",
      in.trigger.distance);
  add("command.trigger.request", input, discrete, kNone,
      "Every increase fires the sensor once, in any mode but 0", in.trigger.request);
  add("command.exposure", input, discrete, kSecond, "Duration of the exposures that fire from now on",
      in.exposure);
}

void TableBuilder::measurement(const std::string& prefix, const std::string& when, Measurement& where,
                               bool live) {
  const auto output = Causality::kOutput;
  const auto discrete = Variability::kDiscrete;
  const Refs position = live ? together({groups_.file, groups_.seed}) : Refs{};
  const Refs rate = live ? groups_.file : Refs{};
  for (std::size_t i = 0; i < kJoints; ++i) {
    add(indexed(prefix + "q", i), output, discrete, kRadian,
        "Angle of joint " + std::to_string(i + 1) + " as its encoder reads it" + when, where.position[i],
        position);
  }
  for (std::size_t i = 0; i < kJoints; ++i) {
    add(indexed(prefix + "qd", i), output, discrete, kRadianPerSecond,
        "Rate of joint " + std::to_string(i + 1) + " as its drive reports it" + when, where.rate[i], rate);
  }
  add(prefix + "table", output, discrete, kRadian,
      "Angle of the table as its encoder reads it, not wrapped" + when, where.position[kTableAxis], position);
  add(prefix + "table_rate", output, discrete, kRadianPerSecond,
      "Rate of the table as its drive reports it" + when, where.rate[kTableAxis], rate);
}

void TableBuilder::body(const std::string& prefix, const std::string& what, const std::string& when,
                        BodyState& where, const Refs& dependencies) {
  const auto output = Causality::kOutput;
  const auto variability = dependencies.empty() ? Variability::kDiscrete : Variability::kContinuous;
  for (std::size_t i = 0; i < 3; ++i) {
    add(indexed(prefix + ".position", i), output, variability, kMetre,
        "True " + std::string(kAxisNames[i]) + " of the origin of " + what + " in the world" + when,
        where.position[i], dependencies);
  }
  for (std::size_t i = 0; i < 4; ++i) {
    add(indexed(prefix + ".orientation", i), output, variability, kNone,
        "True orientation of " + what + " in the world, " + kQuaternionNames[i] +
            " of the unit quaternion with w >= 0" + when,
        where.orientation[i], dependencies);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    add(indexed(prefix + ".velocity", i), output, variability, kMetrePerSecond,
        "True velocity of the origin of " + what + " along the world's " + kAxisNames[i] + when,
        where.velocity[i], dependencies);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    add(indexed(prefix + ".angular_velocity", i), output, variability, kRadianPerSecond,
        "True angular velocity of " + what + " about the world's " + kAxisNames[i] + when,
        where.angular_velocity[i], dependencies);
  }
}

void TableBuilder::bodies(const std::string& prefix, const std::string& when, Bodies& where, bool live) {
  const auto when_live = [live](const Refs& refs) { return live ? refs : Refs{}; };
  for (std::size_t i = 0; i < kJoints; ++i) {
    body(indexed(prefix + "link", i), "link " + std::to_string(i + 1), when, where[i],
         when_live(groups_.links[i]));
  }
  body(prefix + "sensor", "the sensor", when, where[kSensor], when_live(groups_.tool));
  body(prefix + "table", "the table's platter", when, where[kTable], when_live(groups_.platter));
  body(indexed(prefix + "part", 0), "the part", when, where[kPart], when_live(groups_.platter));
}

void TableBuilder::record() {
  const auto output = Causality::kOutput;
  const auto discrete = Variability::kDiscrete;
  TriggerRecord& record = values_.outputs.trigger;
  add("trigger.count", output, discrete, kNone, "Exposures fired so far", values_.outputs.trigger_count);
  add("trigger.index", output, discrete, kNone,
      "Number of the exposure whose record is on display, counted from 1; 0 before the first. Every "
      "communication step "
      "displays the next finished record, if there is one",
      record.index);
  add("trigger.queued", output, discrete, kNone, "Finished records that wait for their display",
      values_.outputs.trigger_queued);
  add("trigger.time", output, discrete, kSecond, "Middle of the exposure on display", record.time);
  add("trigger.exposure", output, discrete, kSecond, "Duration of the exposure on display", record.exposure);
  add("trigger.segment", output, discrete, kNone, "Path segment in which the exposure on display fired",
      record.segment);
  measurement("trigger.measured.", ", latched in the middle of the exposure on display", record.measured,
              false);
  bodies("trigger.truth.", ", when the light of the exposure on display came", record.truth, false);
}

std::vector<Variable> TableBuilder::build() {
  add("time", Causality::kIndependent, Variability::kContinuous, kSecond, "Simulation time", values_.time);
  parameters();
  command();
  measurement("measured.", "", values_.outputs.measured, true);
  Truth& truth = values_.outputs.truth;
  for (std::size_t i = 0; i < kJoints; ++i) {
    add(indexed("truth.q", i), Causality::kOutput, Variability::kContinuous, kRadian,
        "True angle of joint " + std::to_string(i + 1) +
            " at its drive; the zero error of the arm as built comes on top",
        truth.position[i], groups_.file);
  }
  add("truth.table", Causality::kOutput, Variability::kContinuous, kRadian,
      "True angle of the table, not wrapped", truth.position[kTableAxis], groups_.file);
  bodies("truth.", "", truth.bodies, true);
  record();
  add("controller.moving", Causality::kOutput, Variability::kDiscrete, kNone, "Whether any axis is in motion",
      values_.outputs.moving);
  add("controller.limit", Causality::kOutput, Variability::kDiscrete, kNone,
      "First axis that a position or speed limit keeps from its set-point: 1 to 6 joint, 7 table, 0 none",
      values_.outputs.limit);
  return std::move(table_);
}

}  // namespace

const std::vector<Variable>& variables() {
  static const std::vector<Variable> table = TableBuilder().build();
  return table;
}

const std::string& instantiation_token() {
  static const std::string token = [] {
    // FNV-1a over what an importer relies on: order, names, types and causalities.
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
    return std::string(text);
  }();
  return token;
}

}  // namespace robotcell::fmi
