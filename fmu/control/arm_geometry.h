// Nominal kinematics of the arm as the controller uses it, and numerical inverse kinematics.
#pragma once

#include <Eigen/Geometry>
#include <optional>

#include "fmu/control/axis.h"

namespace robotcell::control {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// Pose and Jacobian of the tool at given joint angles.
struct ToolState {
  Eigen::Isometry3d pose;  // world_from_tool
  Matrix6 jacobian;        // rows 0-2: velocity of the tool's origin; 3-5: angular velocity; world axes
};

/// Nominal forward kinematics, without deviations of the arm as built.
class ArmGeometry {
 public:
  virtual ~ArmGeometry() = default;
  virtual ToolState tool(const Axes& position) const = 0;
};

/// Smallest singular value of the Jacobian (rows in m and rad) at which a path still counts as regular. Below
/// it joint rates grow without bound; it corresponds to a wrist bent by about 0.8 degrees.
constexpr double kMinSingularValue = 0.01;

/// Smallest singular value of a Jacobian, a measure of the distance to a singularity.
double smallest_singular_value(const Matrix6& jacobian);

/// Translation and rotation vector, both in world axes, that lead from one pose to another.
Vector6 pose_difference(const Eigen::Isometry3d& from, const Eigen::Isometry3d& to);

/// Pose at the fraction s of the way from `from` along a pose difference: straight, with rotation about a
/// constant axis.
Eigen::Isometry3d interpolate_pose(const Eigen::Isometry3d& from, const Vector6& difference, double s);

/// Joint positions of a solution of the inverse kinematics, and the Jacobian there.
struct JointSolution {
  Axes position;
  Matrix6 jacobian;
};
std::optional<JointSolution> solve_inverse_kinematics(const ArmGeometry& arm, const Eigen::Isometry3d& pose,
                                                      const Axes& position);

}  // namespace robotcell::control
