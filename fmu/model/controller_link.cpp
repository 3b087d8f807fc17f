#include "fmu/model/controller_link.h"

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

namespace robotcell {
namespace {

static_assert(kAxes == control::kAxes, "the controller moves the arm's joints and the table");

void check_range(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return;
  throw std::invalid_argument("command." + std::string(name) + " must be from " + std::to_string(low) +
                              " to " + std::to_string(high) + ", not " + std::to_string(value));
}

template <class Enumeration>
Enumeration enumerated(const char* name, std::int32_t value, Enumeration last) {
  check_range(name, value, 0, static_cast<double>(last));
  return static_cast<Enumeration>(value);
}

}  // namespace

control::ToolState NominalArm::tool(const control::Axes& position) const {
  const auto links = kinematics_.arm(position, {});
  control::ToolState tool;
  tool.pose = kinematics_.sensor(links.back()).pose;
  Eigen::Isometry3d before = kinematics_.world_from_base();
  for (std::size_t i = 0; i < kJoints; ++i) {
    const Eigen::Vector3d axis = before.linear().col(2);
    tool.jacobian.col(static_cast<int>(i)) << axis.cross(tool.pose.translation() - before.translation()),
        axis;
    before = links[i].pose;
  }
  return tool;
}

control::ControllerSettings settings_of(const CellDescription& cell) {
  control::ControllerSettings settings;
  settings.cycle_us = cell.controller_cycle_us;
  auto& axes = settings.motion.axes;
  for (std::size_t i = 0; i < kJoints; ++i) {
    const JointDescription& joint = cell.joints[i];
    axes[i] = {joint.min, joint.max, joint.max_speed, joint.max_acceleration, joint.max_jerk};
  }
  constexpr double kEndless = std::numeric_limits<double>::infinity();
  axes[kTableAxis] = {-kEndless, kEndless, cell.table.max_speed, cell.table.max_acceleration,
                      cell.table.max_jerk};
  const MotionDescription& motion = cell.motion;
  settings.motion.line_speed = motion.line_speed;
  settings.motion.line_acceleration = motion.line_acceleration;
  settings.motion.turn_speed = motion.turn_speed;
  settings.motion.turn_acceleration = motion.turn_acceleration;
  settings.jog = {motion.jog_joint_share, motion.jog_speed, motion.jog_turn_speed, motion.jog_acceleration,
                  motion.jog_turn_acceleration};
  return settings;
}

control::Command command_of(const MotionCommand& motion) {
  control::Command command;
  command.mode = enumerated("mode", motion.mode, control::Mode::kCartesianJog);
  command.operation = enumerated("operation", motion.operation, control::Operation::kAutomatic);
  command.jog_frame = enumerated("jog_frame", motion.jog_frame, control::JogFrame::kTool);
  command.position = motion.position;
  const auto& p = motion.target_position;
  const auto& q = motion.target_orientation;
  const Eigen::Quaterniond turn(q[0], q[1], q[2], q[3]);
  if (command.mode == control::Mode::kLineMove && !(std::abs(turn.norm() - 1) < 1e-6)) {
    throw std::invalid_argument("command.target.orientation must be a quaternion of length 1, not " +
                                std::to_string(turn.norm()));
  }
  command.pose = Eigen::Translation3d(p[0], p[1], p[2]) * turn.normalized();
  if (!(motion.speed > 0)) throw std::invalid_argument("command.speed must be above 0");
  check_range("speed", motion.speed, 0, 1);
  check_range("monitor_speed", motion.monitor_speed, 0, 1);
  for (const double jog : motion.jog) check_range("jog", jog, -1, 1);
  if (motion.max_age < 0) throw std::invalid_argument("command.max_age must not be negative");
  command.speed = motion.speed;
  command.monitor_speed = motion.monitor_speed;
  command.jog = motion.jog;
  command.start = motion.start;
  command.emergency_stop = motion.emergency_stop;
  command.reset = motion.reset;
  command.heartbeat = motion.heartbeat;
  command.max_age = motion.max_age;
  return command;
}

ControllerOutputs outputs_of(const control::Report& report) {
  return {static_cast<std::int32_t>(report.mode),
          static_cast<std::int32_t>(report.phase),
          static_cast<std::int32_t>(report.refusal),
          report.moving,
          report.limit,
          report.progress,
          report.at_destination,
          report.destination};
}

}  // namespace robotcell
