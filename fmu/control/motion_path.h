// Ways of the axes from one rest to another: straight in the joints, or the tool straight in space.
#pragma once

#include <Eigen/Geometry>
#include <optional>

#include "fmu/control/arm_geometry.h"
#include "fmu/control/smooth_profile.h"

namespace robotcell::control {

/// The axes at a share s of a way, and their derivatives by s.
struct PathPoint {
  Axes position{};
  Axes slope{};
  Axes curvature{};
};

/// A way by its parameter s from 0 to 1. Plain data, so that it can be saved with the controller.
struct MotionPath {
  bool line = false;  // the tool goes straight; else the joints do
  Axes from{};
  Axes to{};                                                 // of a line, as found when it was planned
  Eigen::Vector3d start_position = Eigen::Vector3d::Zero();  // of the tool, world; lines alone
  Eigen::Quaterniond start_turn = Eigen::Quaterniond::Identity();
  Eigen::Vector3d shift = Eigen::Vector3d::Zero();
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();  // rotation vector, world

  /// The point at s; `near` are the axes of a neighbouring point, from which a line is followed. Empty where
  /// a line cannot be followed.
  std::optional<PathPoint> at(double s, const ArmGeometry& arm, const Axes& near) const;

  Eigen::Isometry3d start_pose() const { return Eigen::Translation3d(start_position) * start_turn; }
  Vector6 way() const;
};

MotionPath joint_path(const Axes& from, const Axes& to);

/// The tool goes straight from where it is to a pose and turns about one axis meanwhile, the table turns in
/// step.
MotionPath line_path(const ArmGeometry& arm, const Axes& from, const Eigen::Isometry3d& target,
                     double table_target);

/// What programmed motion may not exceed.
struct MotionLimits {
  Limits axes;
  double line_speed = 0;         // m/s, of the tool
  double line_acceleration = 0;  // m/s^2
  double turn_speed = 0;         // rad/s, of the tool
  double turn_acceleration = 0;  // rad/s^2
};

enum class PathFault { kNone, kTargetOutOfLimits, kPathOutOfLimits, kSingular };

/// What was found out about a way before it is gone.
struct PathReport {
  PathFault fault = PathFault::kNone;
  int axis = 0;  // 1..7, of the limit
  ProfileLimits profile;
  Axes end{};
};

/// Goes along the way in thought: whether it can be gone, and how fast at a share of the full speed.
PathReport inspect(const MotionPath& path, const ArmGeometry& arm, const MotionLimits& limits, double speed);

}  // namespace robotcell::control
