#include "fmu/control/motion_path.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace robotcell::control {
namespace {

constexpr double kDifferenceStep = 1e-4;  // of s, for finite differences of the joint rates
constexpr double kCheckSpacing = 2e-3;  // m, and rad / 4: spacing of the checked points of a linear tool path
constexpr double kMaxPoints = 5000;
constexpr double kSpeedShare = 0.999;  // margin for the overshoot of the cubics between knots
constexpr double kPathAccelerationShare = 0.95;

/// Derivatives of the axes by s along a linear tool path (resolved rate): the joints make up for what the
/// axes that carry the arm move the tool.
Axes derivative_of(const MotionPath& path, const ArmGeometry& arm, const Jacobian& jacobian) {
  Vector6 by_joints = path.displacement();
  for (std::size_t i = kMaxJoints; i < kAxes; ++i) {
    const double travel = path.to[i] - path.from[i];
    if (travel != 0) by_joints -= travel * jacobian.col(static_cast<int>(i));
  }
  Axes derivative = resolved_rates(arm, cartesian_columns(arm, jacobian), by_joints);
  for (std::size_t i = kMaxJoints; i < kAxes; ++i) derivative[i] = path.to[i] - path.from[i];
  return derivative;
}

Axes second_derivative_of(const MotionPath& path, const ArmGeometry& arm, const PathPoint& point) {
  Axes ahead = point.position;
  for (std::size_t i = 0; i < kAxes; ++i) ahead[i] += kDifferenceStep * point.derivative[i];
  const Axes derivative = derivative_of(path, arm, arm.tool(ahead).jacobian);
  Axes second_derivative{};
  for (std::size_t i = 0; i < kAxes; ++i) {
    second_derivative[i] = (derivative[i] - point.derivative[i]) / kDifferenceStep;
  }
  return second_derivative;
}

/// First axis outside its position limits, counted from 1; 0: none.
int axis_outside(const Axes& position, const Limits& limits) {
  for (std::size_t i = 0; i < kAxes; ++i) {
    if (!(position[i] >= limits[i].min && position[i] <= limits[i].max)) return static_cast<int>(i) + 1;
  }
  return 0;
}

/// Tightens the profile limits so that the axis limits hold at one more point. Where the path is curved, half
/// of an axis' acceleration is kept for the change of speed and half for the curvature.
void tighten(ProfileLimits& profile, const PathPoint& point, const Limits& limits, double speed) {
  for (std::size_t i = 0; i < kAxes; ++i) {
    const double derivative = std::abs(point.derivative[i]);
    const double second = std::abs(point.second_derivative[i]);
    const double fraction = second > 0 ? 0.5 : 1;
    const double acceleration = fraction * kPathAccelerationShare * limits[i].max_acceleration;
    if (derivative > 0) {
      profile.speed = std::min(profile.speed, speed * kSpeedShare * limits[i].max_speed / derivative);
      profile.acceleration = std::min(profile.acceleration, acceleration / derivative);
      profile.jerk = std::min(profile.jerk, fraction * limits[i].max_jerk / derivative);
    }
    if (second > 0) profile.speed = std::min(profile.speed, std::sqrt(acceleration / second));
  }
}

/// Limits of the speeds of tool and further axes at the fraction `speed`, and of the accelerations of the
/// tool.
ProfileLimits commanded_limits(const MotionPath& path, const MotionLimits& limits, double speed) {
  constexpr double kNoLimit = std::numeric_limits<double>::infinity();
  ProfileLimits profile{kNoLimit, kNoLimit, kNoLimit};
  const double length = path.translation.norm();
  const double angle = path.rotation_vector.norm();
  if (length > 0) profile = {speed * limits.line_speed / length, limits.line_acceleration / length, kNoLimit};
  if (angle > 0) {
    profile.speed = std::min(profile.speed, speed * limits.angular_speed / angle);
    profile.acceleration = std::min(profile.acceleration, limits.angular_acceleration / angle);
  }
  for (std::size_t i = kMaxJoints; i < kAxes; ++i) {
    const double travel = std::abs(path.to[i] - path.from[i]);
    const double axis_speed = kSpeedShare * limits.axes[i].max_speed;
    if (travel > 0) profile.speed = std::min(profile.speed, speed * axis_speed / travel);
  }
  return profile;
}

double number_of_points(const MotionPath& path) {
  const double longest = std::max(path.translation.norm(), path.rotation_vector.norm() / 4);
  return std::clamp(std::ceil(longest / kCheckSpacing), 10.0, kMaxPoints);
}

PathReport check_line_path(const MotionPath& path, const ArmGeometry& arm, const MotionLimits& limits,
                           double speed) {
  PathReport report;
  report.profile = commanded_limits(path, limits, speed);
  Axes near = path.from;
  const double points = number_of_points(path);
  for (double k = 0; k <= points; ++k) {
    const auto point = path.at(k / points, arm, near);
    if (!point || smallest_singular_value(cartesian_columns(arm, arm.tool(point->position).jacobian)) <
                      kMinSingularValue) {
      report.fault = PathFault::kSingular;
      return report;
    }
    report.axis = axis_outside(point->position, limits.axes);
    if (report.axis != 0) {
      report.fault = k == points ? PathFault::kTargetOutOfLimits : PathFault::kPathOutOfLimits;
      return report;
    }
    tighten(report.profile, *point, limits.axes, 1);
    near = point->position;
  }
  report.end = near;
  return report;
}

}  // namespace

Vector6 MotionPath::displacement() const {
  Vector6 displacement;
  displacement << translation, rotation_vector;
  return displacement;
}

/// Solution of the inverse kinematics with the axes beyond the arm's; of a path in the joints, its position
/// alone.
std::optional<JointSolution> MotionPath::solution_at(double s, const ArmGeometry& arm,
                                                     const Axes& near) const {
  Axes position = near;
  for (std::size_t i = line ? kMaxJoints : 0; i < kAxes; ++i) {
    position[i] = s == 1 ? to[i] : from[i] + s * (to[i] - from[i]);
  }
  if (!line) return JointSolution{position, {}};
  return solve_inverse_kinematics(arm, interpolate_pose(start_pose(), displacement(), s), position);
}

std::optional<Axes> MotionPath::position_at(double s, const ArmGeometry& arm, const Axes& near) const {
  const auto solution = solution_at(s, arm, near);
  return solution ? std::optional<Axes>(solution->position) : std::nullopt;
}

std::optional<PathPoint> MotionPath::at(double s, const ArmGeometry& arm, const Axes& near) const {
  const auto solution = solution_at(s, arm, near);
  if (!solution) return std::nullopt;
  PathPoint point;
  point.position = solution->position;
  if (!line) {
    for (std::size_t i = 0; i < kAxes; ++i) point.derivative[i] = to[i] - from[i];
    return point;
  }
  point.derivative = derivative_of(*this, arm, solution->jacobian);
  point.second_derivative = second_derivative_of(*this, arm, point);
  return point;
}

MotionPath joint_path(const Axes& from, const Axes& to) {
  MotionPath path;
  path.from = from;
  path.to = to;
  return path;
}

MotionPath line_path(const ArmGeometry& arm, const Axes& from, const Eigen::Isometry3d& target,
                     const Axes& to) {
  MotionPath path;
  path.line = true;
  path.from = path.to = from;
  std::copy(to.begin() + kMaxJoints, to.end(), path.to.begin() + kMaxJoints);
  const Eigen::Isometry3d start = arm.tool(from).pose;
  path.start_position = start.translation();
  path.start_orientation = Eigen::Quaterniond(start.linear());
  const Vector6 displacement = pose_difference(path.start_pose(), target);
  path.translation = displacement.head<3>();
  path.rotation_vector = displacement.tail<3>();
  return path;
}

PathReport check_path(const MotionPath& path, const ArmGeometry& arm, const MotionLimits& limits,
                      double speed) {
  if (path.line) return check_line_path(path, arm, limits, speed);
  PathReport report;
  report.axis = axis_outside(path.to, limits.axes);
  if (report.axis != 0) {
    report.fault = PathFault::kTargetOutOfLimits;
    return report;
  }
  constexpr double kNoLimit = std::numeric_limits<double>::infinity();
  report.profile = {kNoLimit, kNoLimit, kNoLimit};
  tighten(report.profile, *path.at(0, arm, path.from), limits.axes, speed);
  report.end = path.to;
  return report;
}

}  // namespace robotcell::control
