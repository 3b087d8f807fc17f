#include "fmu/control/arm_geometry.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>

namespace robotcell::control {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

constexpr int kMaxIterations = 10;
constexpr double kTolerance = 1e-11;   // m and rad
constexpr double kMaxJointStep = 0.5;  // rad of any joint in one correction

}  // namespace

Jacobian cartesian_columns(const ArmGeometry& arm, const Jacobian& jacobian) {
  const std::vector<int>& joints = arm.cartesian_joints();
  Jacobian columns(6, joints.size());
  for (std::size_t i = 0; i < joints.size(); ++i) columns.col(static_cast<int>(i)) = jacobian.col(joints[i]);
  return columns;
}

Axes resolved_rates(const ArmGeometry& arm, const Jacobian& columns, const Vector6& twist) {
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxJoints, 1> rates;
  if (columns.cols() == 6) {
    rates = Matrix6(columns).partialPivLu().solve(twist);
  } else {
    rates = columns.colPivHouseholderQr().solve(twist);
  }
  Axes axes{};
  const std::vector<int>& joints = arm.cartesian_joints();
  for (std::size_t i = 0; i < joints.size(); ++i) {
    axes[static_cast<std::size_t>(joints[i])] = rates[static_cast<int>(i)];
  }
  return axes;
}

double smallest_singular_value(const Jacobian& jacobian) {
  using Square = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxJoints, kMaxJoints>;
  const Square square =
      jacobian.cols() < 6 ? Square(jacobian.transpose() * jacobian) : Square(jacobian * jacobian.transpose());
  const Eigen::SelfAdjointEigenSolver<Square> solver(square, Eigen::EigenvaluesOnly);
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
  JointSolution solution{position, {}};
  for (int i = 0; i < kMaxIterations; ++i) {
    const ToolState tool = arm.tool(solution.position);
    solution.jacobian = tool.jacobian;
    const Vector6 error = pose_difference(tool.pose, pose);
    if (error.norm() < kTolerance) return solution;
    const Axes step = resolved_rates(arm, cartesian_columns(arm, tool.jacobian), error);
    for (std::size_t k = 0; k < kAxes; ++k) {
      if (!(std::abs(step[k]) < kMaxJointStep)) return std::nullopt;
      solution.position[k] += step[k];
    }
  }
  return std::nullopt;
}

}  // namespace robotcell::control
