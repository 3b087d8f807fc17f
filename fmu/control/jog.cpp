#include "fmu/control/jog.h"

#include <algorithm>
#include <cmath>

namespace robotcell::control {
namespace {

constexpr double kAccelerationShare = 0.97;  // the rest is for the overshoot of the cubics between knots
constexpr double kBrakingShare = 0.999;      // margin for rounding

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

/// `from` moved towards `to` by at most `max_distance`.
Eigen::Vector3d moved_towards(const Eigen::Vector3d& from, const Eigen::Vector3d& to, double max_distance) {
  const Eigen::Vector3d change = to - from;
  const double distance = change.norm();
  return distance <= max_distance ? to : Eigen::Vector3d(from + change * (max_distance / distance));
}

Eigen::Vector3d limited_to_unit_norm(const Eigen::Vector3d& vector) {
  return vector / std::max(1.0, vector.norm());
}

bool jog_released(const Command& command) {
  return std::all_of(command.jog.begin(), command.jog.end(), [](double j) { return j == 0; });
}

bool at_rest(const Knots& knots) {
  return std::all_of(knots.begin(), knots.end(), [](const Knot& knot) { return knot.velocity == 0; });
}

Axes positions(const Knots& knots) {
  Axes axes;
  for (std::size_t i = 0; i < kAxes; ++i) axes[i] = knots[i].position;
  return axes;
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
  Axes wanted;
  for (std::size_t i = 0; i < kAxes; ++i) {
    wanted[i] = command.jog[i] * jog_.joint_share * limits_[i].max_speed;
  }
  const Jacobian jacobian = arm_.tool(positions(present)).jacobian;
  Eigen::Vector3d tool_velocity = Eigen::Vector3d::Zero();
  for (int i = 0; i < jacobian.cols(); ++i) {
    tool_velocity += wanted[static_cast<std::size_t>(i)] * jacobian.col(i).head<3>();
  }
  const double tool_speed = tool_velocity.norm();
  const double scale = std::min(1.0, jog_.line_speed / std::max(tool_speed, 1e-12));
  Axes change{};
  for (std::size_t i = 0; i < kAxes; ++i) {
    change[i] = (i < kTableAxis ? scale * wanted[i] : wanted[i]) - present[i].velocity;
  }
  const double ratio = std::max(1.0, change_ratio(change, jacobian, cycle));
  Knots knots;
  for (std::size_t i = 0; i < kAxes; ++i) {
    knots[i] = axis(i, present[i].velocity + change[i] / ratio, cycle, present);
  }
  return knots;
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
  Vector6 twist;
  Eigen::Isometry3d pose;
  Jacobian columns;  // of Cartesian motion
  Knots knots{};     // joints of the arm; the table is set later
};

Vector6 Jog::commanded_twist(const Command& command) const {
  const auto& jog = command.jog;
  Vector6 twist;
  twist << limited_to_unit_norm({jog[0], jog[1], jog[2]}) * jog_.line_speed,
      limited_to_unit_norm({jog[3], jog[4], jog[5]}) * jog_.angular_speed;
  if (command.jog_frame == JogFrame::kTool) {
    twist.head<3>() = state_.orientation * twist.head<3>();
    twist.tail<3>() = state_.orientation * twist.tail<3>();
  }
  return twist;
}

Vector6 Jog::ramped(const Vector6& wanted, double cycle) const {
  Vector6 twist;
  twist << moved_towards(state_.twist.head<3>(), wanted.head<3>(), jog_.line_acceleration * cycle),
      moved_towards(state_.twist.tail<3>(), wanted.tail<3>(), jog_.angular_acceleration * cycle);
  return twist;
}

/// Joint motion for which the tool has the twist `twist` at the end of the cycle; empty where the inverse
/// kinematics fails.
std::optional<Jog::Attempt> Jog::attempt(const Vector6& twist, double cycle, const Knots& present) const {
  const Eigen::Isometry3d here = Eigen::Translation3d(state_.position) * state_.orientation;
  Attempt attempt{twist, interpolate_pose(here, state_.twist + twist, cycle / 2), {}, {}};
  const auto solution = solve_inverse_kinematics(arm_, attempt.pose, positions(present));
  if (!solution) return std::nullopt;
  attempt.columns = solution->columns;
  const Axes rates = resolved_rates(arm_, solution->columns, twist);
  for (std::size_t i = 0; i < kMaxJoints; ++i) attempt.knots[i] = {solution->position[i], rates[i]};
  return attempt;
}

/// Motion with the commanded twist, scaled down to the speed and acceleration limits of the joints.
std::optional<Jog::Attempt> Jog::within_limits(double cycle, const Command& command,
                                               const Knots& present) const {
  Vector6 wanted = commanded_twist(command);
  auto found = attempt(ramped(wanted, cycle), cycle, present);
  if (!found) return found;
  double speed_ratio = 1;
  for (std::size_t i = 0; i < kMaxJoints; ++i) {
    speed_ratio = std::max(speed_ratio, std::abs(found->knots[i].velocity) / (0.9 * limits_[i].max_speed));
  }
  if (speed_ratio > 1) found = attempt(ramped(found->twist / speed_ratio, cycle), cycle, present);
  if (!found) return found;
  const Vector6 change = found->twist - state_.twist;
  const Axes rates = resolved_rates(arm_, found->columns, change);
  double acceleration_ratio = std::max(1.0, change_ratio(rates, Jacobian(), cycle));
  for (std::size_t i = 0; i < kMaxJoints; ++i) {
    const double acceleration = peak_acceleration(present[i], found->knots[i], cycle);
    acceleration_ratio = std::max(acceleration_ratio, acceleration / (0.8 * limits_[i].max_acceleration));
  }
  if (acceleration_ratio > 1) {
    found = attempt(state_.twist + change / acceleration_ratio, cycle, present);
  }
  return found;
}

/// Whether a limit or a singularity ends the jog here; blocks it and records the reason.
bool Jog::reaches_limit(const Attempt& attempt, double cycle, const Knots& present) {
  const double before =
      smallest_singular_value(cartesian_columns(arm_, arm_.tool(positions(present)).jacobian));
  const double after = smallest_singular_value(attempt.columns);
  // Motion away from a singularity is always allowed.
  if (after < 2 * kMinSingularValue && after < before * (1 - 1e-9)) {
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

Knots Jog::cartesian(double cycle, const Command& command, const Knots& present) {
  const bool waits = state_.brakes_first || (state_.blocked && jog_released(command));
  if (waits && at_rest(present)) enter(present);
  if (state_.blocked || state_.brakes_first) return brake_synchronously(cycle, limits_, present);
  const auto found = within_limits(cycle, command, present);
  if (!found) block(ControllerError::kSingular, 0);
  if (!found || reaches_limit(*found, cycle, present)) return brake_synchronously(cycle, limits_, present);
  state_.twist = found->twist;
  state_.position = found->pose.translation();
  state_.orientation = Eigen::Quaterniond(found->pose.linear());
  Knots knots = found->knots;
  state_.error = ControllerError::kNone;
  state_.limit = 0;
  const AxisLimits& table = limits_[kTableAxis];
  const double turning = present[kTableAxis].velocity;
  const double wanted = command.jog[kTableAxis] * jog_.joint_share * table.max_speed;
  const double step = jog_.joint_share * table.max_acceleration * cycle;
  knots[kTableAxis] = axis(kTableAxis, turning + std::clamp(wanted - turning, -step, step), cycle, present);
  return knots;
}

}  // namespace robotcell::control
