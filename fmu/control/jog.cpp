#include "fmu/control/jog.h"

#include <algorithm>
#include <cmath>

namespace robotcell::control {
namespace {

constexpr double kAccelerationShare = 0.97;  // the rest is for the overshoot of the cubics between knots
constexpr double kBrakingShare = 0.999;      // margin for rounding
constexpr int kParts = 32;                   // of a step of a path for which the inverse kinematics fails

/// Largest speed at the end of a cycle towards a limit `distance` away at its start, from which constant
/// deceleration still stops before the limit.
double max_approach_speed(double distance, double speed, double acceleration, double cycle) {
  const double left = distance - cycle * std::max(0.0, speed) / 2;
  if (left <= 0) return 0;
  const double step = acceleration * cycle;
  return std::min(-step + std::sqrt(step * step + 2 * acceleration * left), left / cycle);
}

/// Commanded speed at the end of a cycle, reduced so that the axis can stop before its position limits.
double speed_within_limits(double wanted, const Knot& knot, const AxisLimits& limits, double cycle) {
  const double acceleration = kAccelerationShare * limits.max_acceleration;
  if (wanted > 0) {
    return std::min(wanted,
                    max_approach_speed(limits.max - knot.position, knot.velocity, acceleration, cycle));
  }
  return std::max(wanted,
                  -max_approach_speed(knot.position - limits.min, -knot.velocity, acceleration, cycle));
}

/// State after a cycle of constant acceleration to `speed`; stops at a position limit.
Knot constant_acceleration_knot(const Knot& start, double speed, const AxisLimits& limits, double cycle) {
  const double end = start.position + cycle * (start.velocity + speed) / 2;
  const double inside = std::clamp(end, limits.min, limits.max);
  return {inside, inside == end ? speed : 0};
}

bool at_rest(const Knots& knots) {
  return std::all_of(knots.begin(), knots.end(), [](const Knot& knot) { return knot.velocity == 0; });
}

/// Whether an axis stops before its position limits where its speed falls by the same amount in each of
/// `cycles` cycles (not a whole number).
bool stops_within_limits(const Knot& knot, const AxisLimits& limits, double cycle, double cycles) {
  const double whole = std::ceil(std::max(1.0, cycles));
  const double mean_speeds = whole - 0.5 - (cycles > 1 ? whole * (whole - 1) / (2 * cycles) : 0);
  const double stop = knot.position + knot.velocity * cycle * mean_speeds;
  return stop >= limits.min && stop <= limits.max;
}

}  // namespace

bool jog_released(const Command& command) {
  return std::all_of(command.jog.begin(), command.jog.end(), [](double j) { return j == 0; });
}

Knots brake_synchronously(double cycle, const Limits& limits, const Knots& present) {
  double cycles = 0;  // cycles that the slowest axis needs to stop
  for (std::size_t i = 0; i < kAxes; ++i) {
    cycles = std::max(cycles,
                      std::abs(present[i].velocity) / (kBrakingShare * limits[i].max_acceleration * cycle));
  }
  const double factor = cycles > 1 ? 1 - 1 / cycles : 0;
  Knots knots;
  for (std::size_t i = 0; i < kAxes; ++i) {
    double speed = factor * present[i].velocity;
    if (!stops_within_limits(present[i], limits[i], cycle, cycles)) {
      const double step = limits[i].max_acceleration * cycle;
      speed = present[i].velocity - std::clamp(present[i].velocity, -step, step);
    }
    knots[i] = constant_acceleration_knot(present[i], speed, limits[i], cycle);
  }
  return knots;
}

Axes Jog::deflection(const Command& command) {
  Axes deflection = command.jog;
  if (command.mode != Mode::kCartesianJog) return deflection;
  for (double* part : {deflection.data(), deflection.data() + 3}) {
    Eigen::Map<Eigen::Vector3d> vector(part);
    vector /= std::max(1.0, vector.norm());
  }
  return deflection;
}

double Jog::share_of_full(Mode mode, const Axes& deflection) {
  double share = std::abs(deflection[kTableAxis]);
  if (mode == Mode::kCartesianJog) {
    for (const double* part : {deflection.data(), deflection.data() + 3}) {
      share = std::max(share, Eigen::Map<const Eigen::Vector3d>(part).norm());
    }
    return share;
  }
  for (const double value : deflection) share = std::max(share, std::abs(value));
  return share;
}

double Jog::share_of_ahead(const Command& command, const Knots& present) const {
  if (at_rest(present)) return 0;
  if (command.mode == Mode::kCartesianJog) {
    const double ahead = commanded_speed(command, 0).norm();
    const bool brakes = state_.brakes_first || state_.blocked;
    return brakes || state_.speed.norm() > ahead ? 1 : state_.speed.norm() / ahead;
  }
  const Axes rates = joint_rates(command, arm_.tool(positions(present)).jacobian);
  double share = 0;
  for (std::size_t i = 0; i < kAxes; ++i) {
    if (present[i].velocity != 0) share = std::max(share, std::abs(present[i].velocity / rates[i]));
  }
  return std::min(1.0, share);
}

/// Whether a singularity ends a Cartesian jog that leads from `present` to joints with `columns`; motion away
/// from it is always allowed.
bool Jog::enters_singularity(const Axes& present, const Jacobian& columns) const {
  const double after = smallest_singular_value(columns);
  if (after >= 2 * kMinSingularValue) return false;
  return after < (1 - 1e-9) * smallest_singular_value(cartesian_columns(arm_, arm_.tool(present).jacobian));
}

/// Moves the axes and the pose of the tool on by `time` seconds; false, and nothing moves, where the inverse
/// kinematics fails or a singularity ends the jog. In the frame of the tool the speed turns with it, until
/// the middle by half of its rotation.
bool Jog::move_on(double time, JogFrame frame, JogSpeed& speed, Eigen::Isometry3d& pose,
                  Axes& position) const {
  Vector6 way = time * speed.head<6>();
  const bool turns = frame == JogFrame::kTool;
  const Eigen::Matrix3d half = interpolate_pose(Eigen::Isometry3d::Identity(), way, 0.5).linear();
  if (turns) way.head<3>() = half * way.head<3>();
  const Eigen::Isometry3d next = interpolate_pose(pose, way, 1);
  const auto solution = solve_inverse_kinematics(arm_, next, position);
  if (!solution || enters_singularity(position, cartesian_columns(arm_, solution->jacobian))) return false;
  pose = next;
  if (turns) speed.head<3>() = half * half * speed.head<3>();
  position = solution->position;
  position[kTableAxis] += time * speed[6];
  return true;
}

PathAhead Jog::path_ahead(const Command& command, const Knots& present, double step) const {
  Axes position = positions(present);
  const ToolState tool = arm_.tool(position);
  const bool joints = command.mode == Mode::kJointJog, rests = at_rest(present);
  const double share = joints || rests ? 1 : share_of_ahead(command, present);
  Axes change;  // in a step, of axes that keep their speeds
  for (std::size_t i = 0; i < kAxes; ++i) change[i] = step * present[i].velocity / share;
  JogSpeed speed = commanded_speed(command, 0);
  if (state_.speed.norm() > speed.norm()) speed = state_.speed;
  bool straight = !joints && !state_.brakes_first && !state_.blocked;
  if (straight && rests) {
    // A slower jog may begin where the first step of this one fails, and brakes along the axes from there.
    const Axes rates = resolved_rates(arm_, cartesian_columns(arm_, tool.jacobian), speed.head<6>());
    for (std::size_t i = 0; i < kMaxJoints; ++i) change[i] = step * rates[i];
    change[kTableAxis] = step * speed[6];
  }
  Eigen::Isometry3d pose = tool.pose;
  PathAhead ahead;
  ahead[0] = position;
  for (std::size_t k = 1; k < kAheadPoints; ++k) {
    Axes end = position;
    if (joints) {
      const Axes rates = joint_rates(command, arm_.tool(position).jacobian);
      for (std::size_t i = 0; i < kAxes; ++i) {
        if (std::abs(step * rates[i]) > std::abs(change[i])) change[i] = step * rates[i];
      }
    } else if (straight && !move_on(step, command.jog_frame, speed, pose, end)) {
      // Slower jogs get nearer to a singular position or to the end of the reach.
      for (int part = 0; part < kParts && straight; ++part) {
        const Axes before = end;
        straight = move_on(step / kParts, command.jog_frame, speed, pose, end);
        for (std::size_t i = 0; i < kAxes && straight; ++i) change[i] = kParts * (end[i] - before[i]);
      }
    }
    for (std::size_t i = 0; i < kAxes; ++i) {
      if (straight) change[i] = end[i] - position[i];
      position[i] += change[i];
    }
    ahead[k] = position;
  }
  return ahead;
}

void Jog::enter(const Knots& present) {
  const Eigen::Isometry3d pose = arm_.tool(positions(present)).pose;
  state_ = {};
  state_.brakes_first = !at_rest(present);
  state_.position = pose.translation();
  state_.orientation = Eigen::Quaterniond(pose.linear());
}

void Jog::block(ControllerError error, int limit) {
  state_.blocked = true;
  state_.error = error;
  state_.limit = limit;
}

Knot Jog::axis(std::size_t i, double wanted, double cycle, const Knots& present) {
  const double step = kAccelerationShare * limits_[i].max_acceleration * cycle;
  const double clear = speed_within_limits(wanted, present[i], limits_[i], cycle);
  if (clear != wanted && state_.limit == 0) {
    state_.error = ControllerError::kPathOutOfLimits;
    state_.limit = static_cast<std::int32_t>(i) + 1;
  }
  const double speed = present[i].velocity + std::clamp(clear - present[i].velocity, -step, step);
  return constant_acceleration_knot(present[i], speed, limits_[i], cycle);
}

Knots Jog::joints(double cycle, const Command& command, const Knots& present) {
  state_.error = ControllerError::kNone;
  state_.limit = 0;
  if (jog_released(command)) return brake_synchronously(cycle, limits_, present);
  const Jacobian jacobian = arm_.tool(positions(present)).jacobian;
  const Axes wanted = joint_rates(command, jacobian);
  Axes change{};
  for (std::size_t i = 0; i < kAxes; ++i) change[i] = wanted[i] - present[i].velocity;
  const double ratio = std::max(1.0, change_ratio(change, jacobian, cycle));
  Knots knots;
  for (std::size_t i = 0; i < kAxes; ++i) {
    knots[i] = axis(i, present[i].velocity + change[i] / ratio, cycle, present);
  }
  return knots;
}

/// Speeds of the axes in a joint jog, reduced in proportion to the speed limit of the tool. The monitor speed
/// scales this limit, so that it is a share of the full speed also where the tool is at its limit.
Axes Jog::joint_rates(const Command& command, const Jacobian& jacobian) const {
  Axes rates;
  for (std::size_t i = 0; i < kAxes; ++i) {
    rates[i] = command.jog[i] * jog_.joint_share * limits_[i].max_speed;
  }
  Eigen::Vector3d tool_velocity = Eigen::Vector3d::Zero();
  for (int i = 0; i < jacobian.cols(); ++i) {
    tool_velocity += rates[static_cast<std::size_t>(i)] * jacobian.col(i).head<3>();
  }
  const double limit = command.monitor_speed * jog_.line_speed;
  const double scale = std::min(1.0, limit / std::max(tool_velocity.norm(), 1e-12));
  for (double& rate : rates) rate *= scale;
  return rates;
}

/// Largest ratio of a change of axis speeds within a cycle to the limits of axes and tool.
double Jog::change_ratio(const Axes& change, const Jacobian& jacobian, double cycle) const {
  double ratio = 0;
  for (std::size_t i = 0; i < kAxes; ++i) {
    const double acceleration = jog_.joint_share * limits_[i].max_acceleration;
    ratio = std::max(ratio, std::abs(change[i]) / (acceleration * cycle));
  }
  Vector6 twist = Vector6::Zero();
  for (int i = 0; i < jacobian.cols(); ++i) twist += change[static_cast<std::size_t>(i)] * jacobian.col(i);
  ratio = std::max(ratio, twist.head<3>().norm() / (jog_.line_acceleration * cycle));
  return std::max(ratio, twist.tail<3>().norm() / (jog_.angular_acceleration * cycle));
}

struct Jog::Attempt {
  JogSpeed speed;
  Eigen::Isometry3d pose;
  Jacobian columns;  // of Cartesian motion
  Knots knots{};
};

/// Speed of a jog `later` seconds after the reference: in the frame of the tool its direction turns with it.
JogSpeed Jog::commanded_speed(const Command& command, double later) const {
  const Axes jog = deflection(command);
  JogSpeed speed;
  speed << Eigen::Map<const Eigen::Vector3d>(jog.data()) * jog_.line_speed,
      Eigen::Map<const Eigen::Vector3d>(jog.data() + 3) * jog_.angular_speed,
      jog[kTableAxis] * jog_.joint_share * limits_[kTableAxis].max_speed;
  if (command.jog_frame == JogFrame::kTool) {
    Vector6 turned = Vector6::Zero();
    turned.tail<3>() = state_.speed.segment<3>(3);
    const Eigen::Matrix3d turn = interpolate_pose(Eigen::Isometry3d::Identity(), turned, later).linear();
    speed.head<3>() = turn * (state_.orientation * speed.head<3>());
    speed.segment<3>(3) = state_.orientation * speed.segment<3>(3);
  }
  return speed;
}

/// Translation, rotation and table change in proportion: the path does not depend on the speed.
JogSpeed Jog::ramped(const JogSpeed& wanted, double cycle) const {
  const JogSpeed change = wanted - state_.speed;
  const double table_acceleration = jog_.joint_share * limits_[kTableAxis].max_acceleration;
  const double ratio = std::max({change.head<3>().norm() / (jog_.line_acceleration * cycle),
                                 change.segment<3>(3).norm() / (jog_.angular_acceleration * cycle),
                                 std::abs(change[6]) / (table_acceleration * cycle)});
  return ratio <= 1 ? wanted : JogSpeed(state_.speed + change / ratio);
}

/// Motion of the axes with the speed `speed` at the end of the cycle; empty where the inverse kinematics
/// fails.
std::optional<Jog::Attempt> Jog::attempt(const JogSpeed& speed, double cycle, const Knots& present) const {
  const Eigen::Isometry3d here = Eigen::Translation3d(state_.position) * state_.orientation;
  const Vector6 twist = speed.head<6>();
  const Vector6 twice = state_.speed.head<6>() + twist;
  Attempt attempt{speed, interpolate_pose(here, twice, cycle / 2), {}, {}};
  const auto solution = solve_inverse_kinematics(arm_, attempt.pose, positions(present));
  if (!solution) return std::nullopt;
  attempt.columns = cartesian_columns(arm_, solution->jacobian);
  const Axes rates = resolved_rates(arm_, attempt.columns, twist);
  for (std::size_t i = 0; i < kMaxJoints; ++i) attempt.knots[i] = {solution->position[i], rates[i]};
  attempt.knots[kTableAxis] =
      constant_acceleration_knot(present[kTableAxis], speed[6], limits_[kTableAxis], cycle);
  for (std::size_t i = kFirstFurtherAxis; i < kAxes; ++i) attempt.knots[i] = {present[i].position, 0};
  return attempt;
}

/// Motion with the commanded speed, scaled down to the speed and acceleration limits of the joints.
std::optional<Jog::Attempt> Jog::within_limits(double cycle, const Command& command,
                                               const Knots& present) const {
  auto found = attempt(ramped(commanded_speed(command, cycle), cycle), cycle, present);
  if (!found) return found;
  double speed_ratio = 1;
  for (std::size_t i = 0; i < kMaxJoints; ++i) {
    speed_ratio = std::max(speed_ratio, std::abs(found->knots[i].velocity) / (0.9 * limits_[i].max_speed));
  }
  if (speed_ratio > 1) found = attempt(ramped(found->speed / speed_ratio, cycle), cycle, present);
  if (!found) return found;
  const JogSpeed change = found->speed - state_.speed;
  const Axes rates = resolved_rates(arm_, found->columns, change.head<6>());
  double acceleration_ratio = std::max(1.0, change_ratio(rates, Jacobian(), cycle));
  for (std::size_t i = 0; i < kMaxJoints; ++i) {
    const double acceleration = peak_acceleration(present[i], found->knots[i], cycle);
    acceleration_ratio = std::max(acceleration_ratio, acceleration / (0.8 * limits_[i].max_acceleration));
  }
  if (acceleration_ratio > 1) {
    found = attempt(state_.speed + change / acceleration_ratio, cycle, present);
  }
  return found;
}

/// Whether a limit or a singularity ends the jog here; blocks it and records the reason.
bool Jog::reaches_limit(const Attempt& attempt, double cycle, const Knots& present) {
  if (enters_singularity(positions(present), attempt.columns)) {
    block(ControllerError::kSingular, 0);
    return true;
  }
  for (std::size_t i = 0; i < kMaxJoints; ++i) {
    const Knot& end = attempt.knots[i];
    const bool clear = speed_within_limits(end.velocity, present[i], limits_[i], cycle) == end.velocity;
    if (!clear || std::abs(end.velocity) > limits_[i].max_speed ||
        peak_acceleration(present[i], end, cycle) > kAccelerationShare * limits_[i].max_acceleration) {
      block(clear ? ControllerError::kSingular : ControllerError::kPathOutOfLimits,
            clear ? 0 : static_cast<int>(i) + 1);
      return true;
    }
  }
  return false;
}

Knots Jog::cartesian(double cycle, const Command& command, bool released, const Knots& present) {
  const bool waits = state_.brakes_first || (state_.blocked && released);
  if (waits && at_rest(present)) enter(present);
  if (state_.blocked || state_.brakes_first) return brake_synchronously(cycle, limits_, present);
  const auto found = within_limits(cycle, command, present);
  if (!found) block(ControllerError::kSingular, 0);
  if (!found || reaches_limit(*found, cycle, present)) return brake_synchronously(cycle, limits_, present);
  state_.speed = found->speed;
  state_.position = found->pose.translation();
  state_.orientation = Eigen::Quaterniond(found->pose.linear());
  state_.error = ControllerError::kNone;
  state_.limit = 0;
  return found->knots;
}

}  // namespace robotcell::control
