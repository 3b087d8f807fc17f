#include "fmu/model/description/cell_description.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <memory>
#include <system_error>

#include "fmu/control/time_units.h"
#include "fmu/model/description/json_reader.h"
#include "fmu/model/description/value_limits.h"

namespace robotcell {
namespace {

constexpr std::size_t kMinJoints = 4;
constexpr double kMaxJointPosition = 1e6;                           // rad
constexpr double kParallel = 1e-6;                                  // sine of the angle between parallel axes
constexpr std::uintmax_t kMaxTextSize = std::uintmax_t{256} << 20;  // bytes of a description or program

/// Opens with the path in UTF-8; `fopen` of Windows reads it in the active code page.
std::FILE* open_file(const std::filesystem::path& path) {
#ifdef _WIN32
  return _wfopen(path.c_str(), L"rb");
#else
  return std::fopen(path.c_str(), "rb");
#endif
}

/// The next bytes of a stream, at most `size`.
std::string read_stream(std::FILE* stream, std::uintmax_t size, const std::string& name) {
  std::string text;
  char buffer[65536];
  while (text.size() < size) {
    const std::uintmax_t wanted = std::min<std::uintmax_t>(sizeof buffer, size - text.size());
    const std::size_t n = std::fread(buffer, 1, static_cast<std::size_t>(wanted), stream);
    if (n == 0) break;
    text.append(buffer, n);
  }
  if (std::ferror(stream) != 0) throw DescriptionError("cannot read " + name);
  return text;
}

MotionDescription parse_motion(const JsonReader& json) {
  json.expect_keys({"line_speed", "line_acceleration", "turn_speed", "turn_acceleration", "jog_speed",
                    "jog_acceleration", "jog_turn_speed", "jog_turn_acceleration", "jog_joint_share"});
  MotionDescription motion;
  motion.line_speed = json.at("line_speed").positive();
  motion.line_acceleration = json.at("line_acceleration").positive();
  motion.angular_speed = json.at("turn_speed").positive();
  motion.angular_acceleration = json.at("turn_acceleration").positive();
  motion.jog_speed = json.at("jog_speed").positive();
  motion.jog_acceleration = json.at("jog_acceleration").positive();
  motion.jog_angular_speed = json.at("jog_turn_speed").positive();
  motion.jog_angular_acceleration = json.at("jog_turn_acceleration").positive();
  motion.jog_joint_share = json.at("jog_joint_share").number(0, 1);
  return motion;
}

/// Reads the limits of an axis among its keys.
control::AxisLimits parse_limits(const JsonReader& json) {
  control::AxisLimits limits;
  limits.min = json.at("min").number(-kMaxJointPosition, kMaxJointPosition);
  limits.max = json.at("max").number(limits.min, kMaxJointPosition);
  limits.max_speed = json.at("max_speed").positive();
  limits.max_acceleration = json.at("max_acceleration").positive();
  limits.max_jerk = json.at("max_jerk").positive();
  return limits;
}

JointDescription parse_joint(const JsonReader& json) {
  json.expect_keys({"a", "d", "alpha", "theta", "min", "max", "max_speed", "max_acceleration", "max_jerk",
                    "start", "encoder_resolution", "encoder_noise", "encoder_latency"},
                   {"beta"});
  JointDescription joint;
  joint.a = json.at("a").number(-kMaxCoordinate, kMaxCoordinate);
  joint.d = json.at("d").number(-kMaxCoordinate, kMaxCoordinate);
  joint.alpha = json.at("alpha").number(-kMaxJointPosition, kMaxJointPosition);
  if (json.has("beta")) joint.beta = json.at("beta").number(-kMaxJointPosition, kMaxJointPosition);
  joint.theta = json.at("theta").number(-kMaxJointPosition, kMaxJointPosition);
  joint.limits = parse_limits(json);
  joint.start = json.at("start").number(joint.limits.min, joint.limits.max);
  joint.encoder = parse_encoder(json);
  return joint;
}

/// Frame of what carries arm, table or an axis: the world, or one of the first `axes` further axes.
std::size_t parse_carrier(const JsonReader& json, std::size_t axes) {
  const std::string text = json.text();
  if (text == "world") return kWorld;
  for (std::size_t i = 0; i < axes; ++i) {
    if (text == "axis[" + std::to_string(i + 1) + "]") return FrameNumbers{}.axis(i);
  }
  json.fail("\"world\", or \"axis[i]\" of an axis that comes before");
}

AxisDescription parse_axis(const JsonReader& json, std::size_t before) {
  json.expect_keys({"name", "slides", "moves_with", "parent_from_joint", "joint_from_frame", "min", "max",
                    "max_speed", "max_acceleration", "max_jerk", "start", "encoder_resolution",
                    "encoder_noise", "encoder_latency"});
  AxisDescription axis;
  axis.name = json.at("name").text();
  axis.slides = json.at("slides").boolean();
  axis.moves_with = parse_carrier(json.at("moves_with"), before);
  axis.parent_from_joint = json.at("parent_from_joint").pose();
  axis.joint_from_frame = json.at("joint_from_frame").pose();
  axis.limits = parse_limits(json);
  axis.start = json.at("start").number(axis.limits.min, axis.limits.max);
  axis.encoder = parse_encoder(json);
  return axis;
}

/// Joints that keep still in Cartesian motion, so that at most six move; numbers from 1 in the description.
std::vector<int> parse_held_joints(const JsonReader& json, std::size_t joints) {
  std::vector<int> held;
  for (const JsonReader& number : json.items(joints > 6 ? joints - 6 : 0)) {
    const auto joint = static_cast<int>(number.integer(1, static_cast<std::int64_t>(joints))) - 1;
    if (std::find(held.begin(), held.end(), joint) != held.end())
      number.fail("a joint that is not listed twice");
    held.push_back(joint);
  }
  return held;
}

void parse_robot(const JsonReader& robot, CellDescription& cell) {
  robot.expect_keys({"world_from_base", "joints", "held_joints", "motion", "dynamics"}, {"moves_with"});
  cell.motion = parse_motion(robot.at("motion"));
  if (robot.has("moves_with"))
    cell.robot_moves_with = parse_carrier(robot.at("moves_with"), cell.axes.size());
  cell.world_from_base = robot.at("world_from_base").pose();
  for (const JsonReader& joint : robot.at("joints").items(kMinJoints, kMaxJoints)) {
    cell.joints.push_back(parse_joint(joint));
  }
  cell.held_joints = parse_held_joints(robot.at("held_joints"), cell.joints.size());
  if (robot.at("dynamics").is_null()) return;
  const double time_step = static_cast<double>(cell.time_step_us) / kMicrosecondsPerSecond;
  cell.dynamics = parse_arm_dynamics(robot.at("dynamics"), cell.joints.size(), time_step);
}

/// The sensor on the flange, or on what carries it instead.
void parse_tool(const JsonReader& tool, CellDescription& cell) {
  if (tool.has("flange_from_sensor")) {
    tool.expect_keys({"flange_from_sensor"});
    cell.carrier_from_sensor = tool.at("flange_from_sensor").pose();
    return;
  }
  tool.expect_keys({"moves_with", "carrier_from_sensor"});
  cell.sensor_moves_with = parse_carrier(tool.at("moves_with"), cell.axes.size());
  cell.carrier_from_sensor = tool.at("carrier_from_sensor").pose();
}

/// Names of the bodies in contact beside `contact.bodies`.
std::vector<std::string> touching_bodies(const CellDescription& cell) {
  std::vector<std::string> names{"table"};
  for (const ConveyorDescription& conveyor : cell.conveyors) names.push_back(conveyor.name);
  for (const PartDescription& part : cell.parts) names.push_back(part.name);
  if (cell.gripper) names.push_back("gripper");
  return names;
}

CellDescription parse_root(const JsonReader& json) {
  std::vector<const char*> optional_keys{"axes", "further_sensors"};
  for_each_sensor_kind([&](auto kind) { optional_keys.push_back(SensorKind<kind>::kKey); });
  json.expect_keys({"format", "name", "time_step_us", "controller_cycle_us", "gravity", "seed", "robot",
                    "tool", "table", "conveyors", "parts", "gripper", "contact", "bodies", "collision"},
                   optional_keys);
  json.at("format").integer(2, 2);
  CellDescription cell;
  cell.name = json.at("name").text();
  cell.time_step_us = json.at("time_step_us").integer(1, 1000000);
  cell.controller_cycle_us = json.at("controller_cycle_us").integer(1, 1000000);
  if (cell.controller_cycle_us % cell.time_step_us != 0) {
    json.at("controller_cycle_us").fail("a multiple of time_step_us");
  }
  cell.gravity = json.at("gravity").coordinates();
  cell.seed = static_cast<std::int32_t>(json.at("seed").integer(std::numeric_limits<std::int32_t>::min(),
                                                                std::numeric_limits<std::int32_t>::max()));
  if (json.has("axes")) {
    for (const JsonReader& axis : json.at("axes").items(0, kMaxFurtherAxes)) {
      cell.axes.push_back(parse_axis(axis, cell.axes.size()));
    }
  }
  parse_robot(json.at("robot"), cell);
  parse_tool(json.at("tool"), cell);
  cell.table = parse_table(json.at("table"));
  if (json.at("table").has("moves_with")) {
    cell.table_moves_with = parse_carrier(json.at("table").at("moves_with"), cell.axes.size());
  }
  if (json.has("further_sensors")) {
    FrameNumbers carriers{cell.joints.size()};
    carriers.axes = cell.axes.size();
    for (const JsonReader& sensor : json.at("further_sensors").items(0, kMaxFurtherSensors)) {
      sensor.expect_keys({"moves_with", "parent_from_sensor"});
      cell.further_sensors.push_back(
          {carriers.parse(sensor.at("moves_with")), sensor.at("parent_from_sensor").pose()});
    }
  }
  for (const JsonReader& conveyor : json.at("conveyors").items()) {
    cell.conveyors.push_back(parse_conveyor(conveyor));
  }
  const auto parts = json.at("parts").items();
  if (parts.empty()) json.at("parts").fail("at least one part");
  FrameNumbers frames{cell.joints.size(), cell.conveyors.size()};
  frames.axes = cell.axes.size();
  frames.further_sensors = cell.further_sensors.size();
  for (const JsonReader& part : parts) cell.parts.push_back(parse_part(part, frames));
  if (!json.at("gripper").is_null()) cell.gripper = parse_gripper(json.at("gripper"));
  cell.sensing = parse_sensing(json, {layout_of(cell).frames(), cell.time_step_us});
  frames.conveyors = 0;
  cell.contact = parse_contact(json.at("contact"), frames, touching_bodies(cell));
  return cell;
}

}  // namespace

CellLayout layout_of(const CellDescription& cell) {
  CellLayout layout;
  for (const JointDescription& joint : cell.joints) {
    const bool last = &joint == &cell.joints.back();
    // A row that needs beta has a deviation of it, because its axes are nearly parallel.
    layout.joints.push_back({!last && (std::abs(std::sin(joint.alpha)) < kParallel || joint.beta != 0)});
  }
  for (const AxisDescription& axis : cell.axes)
    layout.axes.push_back({axis.name, axis.slides, axis.moves_with});
  layout.robot_moves_with = cell.robot_moves_with;
  layout.table_moves_with = cell.table_moves_with;
  for (const FurtherSensorDescription& sensor : cell.further_sensors) {
    layout.further_sensors.push_back(sensor.moves_with);
  }
  layout.sensor_moves_with = cell.sensor_moves_with;
  for (const PartDescription& part : cell.parts) {
    // Like the world, a belt is where the description puts it.
    layout.parts.push_back(part.stands_on < layout.frames().conveyor(0) ? part.stands_on : kWorld);
  }
  layout.conveyors = cell.conveyors.size();
  layout.gripper = cell.gripper.has_value();
  for_each_sensor_kind(
      [&](auto kind) { layout.sensors[kind] = std::get<kind>(cell.sensing.sensors).size(); });
  layout.collision_outputs = cell.sensing.collision.outputs;
  if (layout.collision_outputs) {
    for (const BodyDescription& body : cell.sensing.bodies) layout.bodies.push_back(body.name);
  }
  layout.dynamic_drives = cell.dynamics.has_value();
  return layout;
}

control::Axes start_positions(const CellDescription& cell) {
  control::Axes position{};
  for (std::size_t i = 0; i < cell.joints.size(); ++i) position[i] = cell.joints[i].start;
  position[kTableAxis] = cell.table.start;
  for (std::size_t i = 0; i < cell.axes.size(); ++i) position[kFirstFurtherAxis + i] = cell.axes[i].start;
  return position;
}

CellDescription parse_cell(const std::string& json) {
  const nlohmann::json document = parse_json(json);
  return parse_root(JsonReader(document, ""));
}

std::string read_text_file(const std::string& path) {
  const std::string name = "the file '" + path + "'";
  std::error_code error;
  std::filesystem::path file;
  try {
    file = std::filesystem::u8path(path);
  } catch (const std::filesystem::filesystem_error&) {  // Windows: not UTF-8
    throw DescriptionError("cannot open " + name);
  }
  const std::filesystem::file_status status = std::filesystem::status(file, error);
  if (!std::filesystem::exists(status)) throw DescriptionError("cannot open " + name);
  // A device or a pipe may never end, and reading a file of the kernel, whose size is 0, may never return.
  if (!std::filesystem::is_regular_file(status)) {
    throw DescriptionError("cannot read " + name + ": expected a regular file");
  }
  const std::uintmax_t size = std::filesystem::file_size(file, error);
  if (error) throw DescriptionError("cannot read " + name);
  if (size == 0) return {};
  if (size > kMaxTextSize) {
    throw DescriptionError("cannot read " + name + ": it has " + std::to_string(size >> 20) +
                           " MiB; expected at most " + std::to_string(kMaxTextSize >> 20));
  }
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> stream(open_file(file), &std::fclose);
  if (!stream) throw DescriptionError("cannot open " + name);
  return read_stream(stream.get(), size, name);
}

std::string read_file_or_input(const std::string& path) {
  return path == "-" ? read_stream(stdin, kMaxTextSize, "the standard input") : read_text_file(path);
}

}  // namespace robotcell
