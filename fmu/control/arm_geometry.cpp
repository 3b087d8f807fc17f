#include "fmu/control/arm_geometry.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace robotcell::control {
namespace {

constexpr int kMaxIterations = 10;
constexpr double kTolerance = 1e-11;   // m and rad
constexpr double kMaxJointStep = 0.5;  // rad of any joint in one correction

}  // namespace

double smallest_singular_value(const Matrix6& jacobian) {
  const Matrix6 square = jacobian * jacobian.transpose();
  const Eigen::SelfAdjointEigenSolver<Matrix6> solver(square, Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(0.0, solver.eigenvalues().minCoeff()));
}

Vector6 pose_difference(const Eigen::Isometry3d& from, const Eigen::Isometry3d& to) {
  const Eigen::AngleAxisd rotation(to.linear() * from.linear().transpose());
  Vector6 difference;
  difference << to.translation() - from.translation(), rotation.angle() * rotation.axis();
  return difference;
}

Eigen::Isometry3d interpolate_pose(const Eigen::Isometry3d& from, const Vector6& difference, double s) {
  const Eigen::Vector3d rotation = difference.tail<3>() * s;
  const double angle = rotation.norm();
  Eigen::Isometry3d pose = from;
  if (angle > 0) pose.linear() = Eigen::AngleAxisd(angle, rotation / angle) * from.linear();
  pose.translation() += s * difference.head<3>();
  return pose;
}

std::optional<JointSolution> solve_inverse_kinematics(const ArmGeometry& arm, const Eigen::Isometry3d& pose,
                                                      const Axes& position) {
  JointSolution solution{position, Matrix6::Zero()};
  for (int i = 0; i < kMaxIterations; ++i) {
    const ToolState tool = arm.tool(solution.position);
    solution.jacobian = tool.jacobian;
    const Vector6 error = pose_difference(tool.pose, pose);
    if (error.norm() < kTolerance) return solution;
    const Vector6 step = tool.jacobian.partialPivLu().solve(error);
    if (!(step.cwiseAbs().maxCoeff() < kMaxJointStep)) return std::nullopt;
    for (int k = 0; k < kArmAxes; ++k) solution.position[static_cast<std::size_t>(k)] += step[k];
  }
  return std::nullopt;
}

}  // namespace robotcell::control
