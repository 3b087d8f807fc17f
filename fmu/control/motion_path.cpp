#include "fmu/control/motion_path.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

namespace robotcell::control {
namespace {

constexpr double kNudge = 1e-4;   // of s, over which slopes are compared
constexpr double kStride = 2e-3;  // m, and rad / 4: between two inspected points of a line
constexpr double kMostPoints = 5000;
constexpr double kSpeedShare = 0.999;  // the cubics between the knots overshoot by less than the rest
constexpr double kAccelerationShare = 0.95;
constexpr std::size_t kTable = kArmAxes;

/// Slope of the axes along a line: resolved rate.
Axes slope_of(const MotionPath& path, const Matrix6& jacobian) {
  Axes slope{};
  const Vector6 rates = jacobian.partialPivLu().solve(path.way());
  for (int i = 0; i < kArmAxes; ++i) slope[static_cast<std::size_t>(i)] = rates[i];
  slope[kTable] = path.to[kTable] - path.from[kTable];
  return slope;
}

Axes curvature_of(const MotionPath& path, const ArmGeometry& arm, const PathPoint& point) {
  Axes ahead = point.position;
  for (std::size_t i = 0; i < kAxes; ++i) ahead[i] += kNudge * point.slope[i];
  const Axes slope = slope_of(path, arm.tool(ahead).jacobian);
  Axes curvature{};
  for (std::size_t i = 0; i < kAxes; ++i) curvature[i] = (slope[i] - point.slope[i]) / kNudge;
  return curvature;
}

/// First axis outside its limits, 1..7; 0: none.
int axis_outside(const Axes& position, const Limits& limits) {
  for (std::size_t i = 0; i < kAxes; ++i) {
    if (!(position[i] >= limits[i].min && position[i] <= limits[i].max)) return static_cast<int>(i) + 1;
  }
  return 0;
}

/// Tightens the limits of s so that they hold at one more point. Half of an axis' acceleration is for the
/// change of speed, half for the bend of the way.
void tighten(ProfileLimits& profile, const PathPoint& point, const Limits& limits, double speed) {
  for (std::size_t i = 0; i < kAxes; ++i) {
    const double slope = std::abs(point.slope[i]);
    const double bend = std::abs(point.curvature[i]);
    const double share = bend > 0 ? 0.5 : 1;
    const double acceleration = share * kAccelerationShare * limits[i].max_acceleration;
    if (slope > 0) {
      profile.speed = std::min(profile.speed, speed * kSpeedShare * limits[i].max_speed / slope);
      profile.acceleration = std::min(profile.acceleration, acceleration / slope);
      profile.jerk = std::min(profile.jerk, share * limits[i].max_jerk / slope);
    }
    if (bend > 0) profile.speed = std::min(profile.speed, std::sqrt(acceleration / bend));
  }
}

ProfileLimits limits_of_tool(const MotionPath& path, const MotionLimits& limits, double speed) {
  constexpr double kNoLimit = std::numeric_limits<double>::infinity();
  ProfileLimits profile{kNoLimit, kNoLimit, kNoLimit};
  const double length = path.shift.norm();
  const double angle = path.turn.norm();
  if (length > 0) profile = {speed * limits.line_speed / length, limits.line_acceleration / length, kNoLimit};
  if (angle > 0) {
    profile.speed = std::min(profile.speed, speed * limits.turn_speed / angle);
    profile.acceleration = std::min(profile.acceleration, limits.turn_acceleration / angle);
  }
  return profile;
}

double count_of_points(const MotionPath& path) {
  const double longest = std::max(path.shift.norm(), path.turn.norm() / 4);
  return std::clamp(std::ceil(longest / kStride), 10.0, kMostPoints);
}

PathReport inspect_line(const MotionPath& path, const ArmGeometry& arm, const MotionLimits& limits,
                        double speed) {
  PathReport report;
  report.profile = limits_of_tool(path, limits, speed);
  Axes near = path.from;
  const double points = count_of_points(path);
  for (double k = 0; k <= points; ++k) {
    const auto point = path.at(k / points, arm, near);
    if (!point || regularity(arm.tool(point->position).jacobian) < kSmallestSingularValue) {
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

Vector6 MotionPath::way() const {
  Vector6 way;
  way << shift, turn;
  return way;
}

std::optional<PathPoint> MotionPath::at(double s, const ArmGeometry& arm, const Axes& near) const {
  PathPoint point;
  if (!line) {
    for (std::size_t i = 0; i < kAxes; ++i) {
      point.slope[i] = to[i] - from[i];
      point.position[i] = s == 1 ? to[i] : from[i] + s * point.slope[i];
    }
    return point;
  }
  const auto followed = follow(arm, along(start_pose(), way(), s), near);
  if (!followed) return std::nullopt;
  point.position = followed->position;
  point.slope = slope_of(*this, followed->jacobian);
  point.position[kTable] = s == 1 ? to[kTable] : from[kTable] + s * point.slope[kTable];
  point.curvature = curvature_of(*this, arm, point);
  return point;
}

MotionPath joint_path(const Axes& from, const Axes& to) {
  MotionPath path;
  path.from = from;
  path.to = to;
  return path;
}

MotionPath line_path(const ArmGeometry& arm, const Axes& from, const Eigen::Isometry3d& target,
                     double table_target) {
  MotionPath path;
  path.line = true;
  path.from = path.to = from;
  path.to[kTable] = table_target;
  const Eigen::Isometry3d start = arm.tool(from).pose;
  path.start_position = start.translation();
  path.start_turn = Eigen::Quaterniond(start.linear());
  const Vector6 way = way_between(path.start_pose(), target);
  path.shift = way.head<3>();
  path.turn = way.tail<3>();
  return path;
}

PathReport inspect(const MotionPath& path, const ArmGeometry& arm, const MotionLimits& limits, double speed) {
  if (path.line) return inspect_line(path, arm, limits, speed);
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
