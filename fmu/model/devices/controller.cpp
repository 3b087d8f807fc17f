#include "fmu/model/devices/controller.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <string_view>

namespace robotcell {
namespace {

constexpr double kNormRounding = 0.01;          // of a quaternion that was written with few digits
constexpr double kSameTool = 1e-12;             // rounding of a pose that was converted to a quaternion
constexpr std::string_view kReason = "stop: ";  // begins the text of a guard that stops the robot

/// None where the orientation is no unit quaternion.
std::optional<Eigen::Isometry3d> pose_of(const std::array<double, 3>& position,
                                         const std::array<double, 4>& orientation) {
  const Eigen::Quaterniond rotation(orientation[0], orientation[1], orientation[2], orientation[3]);
  if (!(std::abs(rotation.norm() - 1) < kNormRounding)) return std::nullopt;
  return Eigen::Translation3d(position[0], position[1], position[2]) * rotation.normalized();
}

std::string emergency_text(bool guard_stopped, const std::string& commanded) {
  const std::string stop = "Emergency stop";
  if (guard_stopped) return stop + ": guard message too old";
  const bool has_reason = commanded.compare(0, kReason.size(), kReason) == 0;
  return has_reason ? stop + ": " + commanded.substr(kReason.size()) : stop;
}

}  // namespace

NominalArm::NominalArm(const CellDescription& cell) : kinematics_(cell, AsBuilt{}) {
  const std::vector<int>& held = cell.held_joints;
  for (int i = 0; i < static_cast<int>(cell.joints.size()); ++i) {
    if (std::find(held.begin(), held.end(), i) == held.end()) cartesian_joints_.push_back(i);
  }
}

control::ToolState NominalArm::tool(const control::Axes& position,
                                    const Eigen::Isometry3d& flange_from_tool) const {
  const Tree& tree = kinematics_.tree();
  PlacedTree placed;
  tree.place(position.data(), placed);
  control::ToolState tool;
  tool.pose = placed.frames[kinematics_.numbers().flange()] * flange_from_tool;
  tool.jacobian.setZero(6, kAxes);
  for (const std::size_t joint : tree.path(kinematics_.numbers().flange())) {
    tool.jacobian.col(static_cast<int>(tree[joint].axis)) =
        tree.column(placed, joint, tool.pose.translation());
  }
  return tool;
}

control::ControllerSettings settings_of(const CellDescription& cell) {
  control::ControllerSettings settings;
  settings.cycle_us = cell.controller_cycle_us;
  auto& axes = settings.motion.axes;
  constexpr double kEndless = std::numeric_limits<double>::infinity();
  axes.fill({-kEndless, kEndless, 1, 1, 1});  // of axes that do not exist and stand still
  for (std::size_t i = 0; i < cell.joints.size(); ++i) axes[i] = cell.joints[i].limits;
  const TableDescription& table = cell.table;
  const double travel = table.turns ? kEndless : 0.0;
  axes[kTableAxis] = {table.start - travel, table.start + travel, table.max_speed, table.max_acceleration,
                      table.max_jerk};
  for (std::size_t i = 0; i < cell.axes.size(); ++i) axes[kFirstFurtherAxis + i] = cell.axes[i].limits;
  const MotionDescription& motion = cell.motion;
  settings.motion.line_speed = motion.line_speed;
  settings.motion.line_acceleration = motion.line_acceleration;
  settings.motion.angular_speed = motion.angular_speed;
  settings.motion.angular_acceleration = motion.angular_acceleration;
  settings.jog = {motion.jog_joint_share, motion.jog_speed, motion.jog_angular_speed, motion.jog_acceleration,
                  motion.jog_angular_acceleration};
  return settings;
}

control::Command command_of(const MotionCommand& motion, const Eigen::Isometry3d& flange_from_usual_tool) {
  control::Command command;
  command.mode = static_cast<control::Mode>(motion.mode);
  command.operation = static_cast<control::Operation>(motion.operation);
  command.jog_frame = static_cast<control::JogFrame>(motion.jog_frame);
  command.position = motion.position;
  command.flange_from_tool = pose_of(motion.tool_position, motion.tool_orientation);
  if (command.flange_from_tool && command.flange_from_tool->isApprox(flange_from_usual_tool, kSameTool)) {
    command.flange_from_tool = flange_from_usual_tool;
  }
  command.pose = pose_of(motion.target_position, motion.target_orientation);
  command.speed = motion.speed;
  command.monitor_speed = motion.monitor_speed;
  command.jog = motion.jog;
  command.start = motion.start;
  command.emergency_stop = motion.emergency_stop;
  command.reset = motion.reset;
  command.heartbeat = motion.heartbeat;
  command.max_age = motion.max_age;
  command.guard_max_age = motion.guard_max_age;
  return command;
}

ControllerOutputs outputs_of(const control::Report& report, std::size_t joints, double start_time) {
  const bool joint_limited = report.limit <= kMaxJoints;  // the other axes follow the joints of this arm
  ControllerOutputs outputs;
  outputs.mode = static_cast<std::int32_t>(report.mode);
  outputs.state = static_cast<std::int32_t>(report.phase);
  outputs.error = static_cast<std::int32_t>(report.error);
  outputs.moving = report.moving;
  outputs.limit =
      joint_limited ? report.limit : report.limit - kMaxJoints + static_cast<std::int32_t>(joints);
  outputs.progress = report.progress;
  outputs.clock = report.path_clock.clock;
  outputs.rate = report.rate;
  outputs.at_destination = report.at_destination;
  outputs.destination = report.destination;
  outputs.guard_age = report.guard_age;
  outputs.path_time = start_time + static_cast<double>(report.path_us) * kSecondsPerMicrosecond;
  return outputs;
}

PendantOutputs pendant_of(const control::Report& report, const std::string& refusal,
                          const PendantCommand& command) {
  const bool running = report.path_clock.rate > 0;
  PendantOutputs pendant{command.text, command.beep || report.guard_stopped};
  if (report.phase == control::Phase::kEmergencyStop) {
    pendant.text = emergency_text(report.guard_stopped, command.text);
  } else if (report.guard_stopped) {
    pendant.text = "Stopped: guard message too old, reset to go on";
  } else if (!refusal.empty()) {
    pendant.text = "Rejected: " + refusal;
  } else if (report.guard_waits && command.text.empty()) {
    pendant.text = "Waits for the guard";
  } else if (running && report.guard_share < 1) {
    const auto percent = static_cast<int>(std::lround(100 * report.guard_share));
    pendant.text = "Slowed to " + std::to_string(percent) + " %: guard message is late";
  }
  return pendant;
}

}  // namespace robotcell
