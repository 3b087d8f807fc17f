// Paths between two rest positions: linear in the joints, or linear in space for the tool.
#pragma once

#include <Eigen/Geometry>
#include <optional>

#include "fmu/control/arm_geometry.h"
#include "fmu/control/smooth_profile.h"

namespace robotcell::control {

/// Axis positions at the path parameter s, and their derivatives with respect to s.
struct PathPoint {
  Axes position{};
  Axes derivative{};
  Axes second_derivative{};
};

/// A path with the parameter s from 0 to 1. Plain data, so that it can be serialized with the controller.
struct MotionPath {
  bool line = false;  // true: linear for the tool; false: linear in the joints
  Axes from{};
  Axes to{};  // for a linear tool path: solution of the inverse kinematics found while planning
  Eigen::Vector3d start_position = Eigen::Vector3d::Zero();  // of the tool, world; linear tool paths only
  Eigen::Quaterniond start_orientation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  Eigen::Vector3d rotation_vector = Eigen::Vector3d::Zero();  // world axes

  /// Evaluates the path at s. `near` is the solution at a neighbouring point, from which the inverse
  /// kinematics starts. Empty where the inverse kinematics fails.
  std::optional<PathPoint> at(double s, const ArmGeometry& arm, const Axes& near) const;
  /// Axis positions alone, at less cost.
  std::optional<Axes> position_at(double s, const ArmGeometry& arm, const Axes& near) const;

  Eigen::Isometry3d start_pose() const { return Eigen::Translation3d(start_position) * start_orientation; }
  Vector6 displacement() const;

 private:
  std::optional<JointSolution> solution_at(double s, const ArmGeometry& arm, const Axes& near) const;
};

MotionPath joint_path(const Axes& from, const Axes& to);

/// Path on which the tool moves on a straight line to `target` and rotates about one axis, while the axes
/// beyond the arm's move in proportion to their positions in `to`.
MotionPath line_path(const ArmGeometry& arm, const Axes& from, const Eigen::Isometry3d& target,
                     const Axes& to);

/// Limits of programmed motion.
struct MotionLimits {
  Limits axes;
  double line_speed = 0;            // m/s, of the tool
  double line_acceleration = 0;     // m/s^2
  double angular_speed = 0;         // rad/s, of the tool
  double angular_acceleration = 0;  // rad/s^2
};

enum class PathFault { kNone, kTargetOutOfLimits, kPathOutOfLimits, kSingular, kElsewhere, kTooFast };

/// Result of checking a path before it is executed.
struct PathReport {
  PathFault fault = PathFault::kNone;
  int axis = 0;  // axis that exceeds its limit, counted from 1; 0: none
  ProfileLimits profile;
  Axes end{};
};

/// Checks that a path is feasible (position limits, singularities), and finds its speed profile limits at the
/// fraction `speed` of the full speed.
PathReport check_path(const MotionPath& path, const ArmGeometry& arm, const MotionLimits& limits,
                      double speed);

}  // namespace robotcell::control
