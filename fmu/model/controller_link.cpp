#include "fmu/model/controller_link.h"

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

namespace robotcell {
namespace {

static_assert(kAxes == control::kAxes, "the controller moves the arm's joints and the table");

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
  settings.motion.angular_speed = motion.angular_speed;
  settings.motion.angular_acceleration = motion.angular_acceleration;
  settings.jog = {motion.jog_joint_share, motion.jog_speed, motion.jog_angular_speed, motion.jog_acceleration,
                  motion.jog_angular_acceleration};
  return settings;
}

control::Command command_of(const MotionCommand& motion) {
  control::Command command;
  command.mode = static_cast<control::Mode>(motion.mode);
  command.operation = static_cast<control::Operation>(motion.operation);
  command.jog_frame = static_cast<control::JogFrame>(motion.jog_frame);
  command.position = motion.position;
  const auto& p = motion.target_position;
  const auto& q = motion.target_orientation;
  const Eigen::Quaterniond orientation(q[0], q[1], q[2], q[3]);
  if (command.mode == control::Mode::kLineMove && !(std::abs(orientation.norm() - 1) < 1e-6)) {
    throw std::invalid_argument("command.target.orientation must be a unit quaternion, but its norm is " +
                                std::to_string(orientation.norm()));
  }
  command.pose = Eigen::Translation3d(p[0], p[1], p[2]) * orientation.normalized();
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
          static_cast<std::int32_t>(report.error),
          report.moving,
          report.limit,
          report.progress,
          report.at_destination,
          report.destination};
}

}  // namespace robotcell
