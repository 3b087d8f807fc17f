#include "fmu/control/arm_geometry.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace robotcell::control {
namespace {

constexpr int kMostCorrections = 10;
constexpr double kCloseEnough = 1e-11;  // m and rad
constexpr double kLongestStride = 0.5;  // rad of any joint in one correction

}  // namespace

double regularity(const Matrix6& jacobian) {
  const Matrix6 square = jacobian * jacobian.transpose();
  const Eigen::SelfAdjointEigenSolver<Matrix6> solver(square, Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(0.0, solver.eigenvalues().minCoeff()));
}

Vector6 way_between(const Eigen::Isometry3d& from, const Eigen::Isometry3d& to) {
  const Eigen::AngleAxisd turn(to.linear() * from.linear().transpose());
  Vector6 way;
  way << to.translation() - from.translation(), turn.angle() * turn.axis();
  return way;
}

Eigen::Isometry3d along(const Eigen::Isometry3d& from, const Vector6& way, double s) {
  const Eigen::Vector3d turn = way.tail<3>() * s;
  const double angle = turn.norm();
  Eigen::Isometry3d pose = from;
  if (angle > 0) pose.linear() = Eigen::AngleAxisd(angle, turn / angle) * from.linear();
  pose.translation() += s * way.head<3>();
  return pose;
}

std::optional<Followed> follow(const ArmGeometry& arm, const Eigen::Isometry3d& pose, const Axes& position) {
  Followed followed{position, Matrix6::Zero()};
  for (int i = 0; i < kMostCorrections; ++i) {
    const ToolState tool = arm.tool(followed.position);
    followed.jacobian = tool.jacobian;
    const Vector6 error = way_between(tool.pose, pose);
    if (error.norm() < kCloseEnough) return followed;
    const Vector6 stride = tool.jacobian.partialPivLu().solve(error);
    if (!(stride.cwiseAbs().maxCoeff() < kLongestStride)) return std::nullopt;
    for (int k = 0; k < kArmAxes; ++k) followed.position[static_cast<std::size_t>(k)] += stride[k];
  }
  return std::nullopt;
}

}  // namespace robotcell::control
