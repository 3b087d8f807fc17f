// Nominal kinematics of the arm as the controller uses it, and numerical inverse kinematics.
#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <vector>

#include "fmu/control/axis.h"

namespace robotcell::control {

using Vector6 = Eigen::Matrix<double, 6, 1>;
/// A column for each axis of the controller, or for each joint of Cartesian motion.
using Jacobian = Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, kAxes>;

/// Pose and Jacobian of the tool at positions of the axes.
struct ToolState {
  Eigen::Isometry3d pose;  // world_from_tool
  Jacobian jacobian;       // rows 0-2: velocity of the tool's origin; 3-5: angular velocity; world axes
};

/// Nominal forward kinematics, without deviations of the arm as built.
class ArmKinematics {
 public:
  virtual ~ArmKinematics() = default;
  virtual ToolState tool(const Axes& position, const Eigen::Isometry3d& flange_from_tool) const = 0;
  /// The joints, at most six, that linear moves and Cartesian jogs use. The others keep still, so that an arm
  /// with more than six joints has one solution near every position.
  virtual const std::vector<int>& cartesian_joints() const = 0;
};

/// An arm with the tool that linear moves and jogs refer to.
class ArmGeometry {
 public:
  explicit ArmGeometry(const ArmKinematics& arm) : arm_(arm) {}

  ToolState tool(const Axes& position) const { return arm_.tool(position, flange_from_tool_); }
  const std::vector<int>& cartesian_joints() const { return arm_.cartesian_joints(); }
  const Eigen::Isometry3d& flange_from_tool() const { return flange_from_tool_; }
  /// To be called between motions only: a path holds poses of the tool.
  void set_tool(const Eigen::Isometry3d& flange_from_tool) { flange_from_tool_ = flange_from_tool; }

 private:
  const ArmKinematics& arm_;
  Eigen::Isometry3d flange_from_tool_ = Eigen::Isometry3d::Identity();
};

/// The columns of a Jacobian that belong to the joints of Cartesian motion.
Jacobian cartesian_columns(const ArmGeometry& arm, const Jacobian& jacobian);

/// Rates of the axes for a twist of the tool, by the columns of Cartesian motion; those with the least error
/// where there are fewer than six. Other axes have the rate 0.
Axes resolved_rates(const ArmGeometry& arm, const Jacobian& columns, const Vector6& twist);

/// Smallest singular value of the Jacobian (rows in m and rad) at which a path still counts as regular. Below
/// it joint rates grow without bound; it corresponds to a wrist bent by about 0.8 degrees.
constexpr double kMinSingularValue = 0.01;

/// Smallest singular value of a Jacobian, a measure of the distance to a singularity.
double smallest_singular_value(const Jacobian& jacobian);

/// Translation and rotation vector, both in world axes, that lead from one pose to another.
Vector6 pose_difference(const Eigen::Isometry3d& from, const Eigen::Isometry3d& to);

/// Pose at the fraction s of the way from `from` along a pose difference: straight, with rotation about a
/// constant axis.
Eigen::Isometry3d interpolate_pose(const Eigen::Isometry3d& from, const Vector6& difference, double s);

/// Positions of a solution of the inverse kinematics, and the Jacobian there.
struct JointSolution {
  Axes position;
  Jacobian jacobian;
};
std::optional<JointSolution> solve_inverse_kinematics(const ArmGeometry& arm, const Eigen::Isometry3d& pose,
                                                      const Axes& position);

}  // namespace robotcell::control
