#include "fmu/control/jog.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace robotcell::control {
namespace {

constexpr double kAccelerationShare = 0.97;  // what the cubics between the knots add stays below the rest
constexpr double kBrakingShare = 0.999;      // rounding
constexpr std::size_t kTable = kArmAxes;

/// Greatest speed towards a limit, `distance` away at the start of a cycle, from which constant deceleration
/// still stops in front of it.
double speed_before(double distance, double speed, double acceleration, double cycle) {
  const double left = distance - cycle * std::max(0.0, speed) / 2;
  if (left <= 0) return 0;
  const double step = acceleration * cycle;
  return std::min(-step + std::sqrt(step * step + 2 * acceleration * left), left / cycle);
}

/// The speed that axis `knot` may have at the end of a cycle because of its position limits.
double clear_of_limits(double wanted, const Knot& knot, const AxisLimits& limits, double cycle) {
  const double acceleration = kAccelerationShare * limits.max_acceleration;
  if (wanted > 0) {
    return std::min(wanted, speed_before(limits.max - knot.position, knot.velocity, acceleration, cycle));
  }
  return std::max(wanted, -speed_before(knot.position - limits.min, -knot.velocity, acceleration, cycle));
}

/// Evenly accelerated from one speed to another.
Knot after_cycle(const Knot& start, double speed, const AxisLimits& limits, double cycle) {
  const double end = start.position + cycle * (start.velocity + speed) / 2;
  const double inside = std::clamp(end, limits.min, limits.max);
  return {inside, inside == end ? speed : 0};
}

/// A vector brought nearer to another by at most `most`.
Eigen::Vector3d nearer(const Eigen::Vector3d& from, const Eigen::Vector3d& to, double most) {
  const Eigen::Vector3d change = to - from;
  const double size = change.norm();
  return size <= most ? to : Eigen::Vector3d(from + change * (most / size));
}

Eigen::Vector3d at_most_one(const Eigen::Vector3d& vector) { return vector / std::max(1.0, vector.norm()); }

bool let_go(const Command& command) {
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

}  // namespace

Knots brake_together(double cycle, const Limits& limits, const Knots& present) {
  double cycles = 0;  // that the slowest axis needs
  for (std::size_t i = 0; i < kAxes; ++i) {
    cycles = std::max(cycles,
                      std::abs(present[i].velocity) / (kBrakingShare * limits[i].max_acceleration * cycle));
  }
  const double factor = cycles > 1 ? 1 - 1 / cycles : 0;
  Knots knots;
  for (std::size_t i = 0; i < kAxes; ++i) {
    knots[i] = after_cycle(present[i], factor * present[i].velocity, limits[i], cycle);
  }
  return knots;
}

void Jog::enter(const Knots& present) {
  const Eigen::Isometry3d pose = arm_.tool(positions(present)).pose;
  state_ = {};
  state_.position = pose.translation();
  state_.turn = Eigen::Quaterniond(pose.linear());
}

void Jog::block(Refusal refusal, int limit) {
  state_.blocked = true;
  state_.refusal = refusal;
  state_.limit = limit;
}

Knot Jog::axis(std::size_t i, double wanted, double cycle, const Knots& present) {
  const double step = kAccelerationShare * limits_[i].max_acceleration * cycle;
  const double clear = clear_of_limits(wanted, present[i], limits_[i], cycle);
  if (clear != wanted && state_.limit == 0) {
    state_.refusal = Refusal::kPathOutOfLimits;
    state_.limit = static_cast<std::int32_t>(i) + 1;
  }
  const double speed = present[i].velocity + std::clamp(clear - present[i].velocity, -step, step);
  return after_cycle(present[i], speed, limits_[i], cycle);
}

Knots Jog::joints(double cycle, const Command& command, const Knots& present) {
  Axes wanted;
  for (std::size_t i = 0; i < kAxes; ++i) {
    wanted[i] = command.jog[i] * jog_.joint_share * limits_[i].max_speed;
  }
  const Matrix6 jacobian = arm_.tool(positions(present)).jacobian;
  const double tool_speed = (jacobian.topRows<3>() * Eigen::Map<const Vector6>(wanted.data())).norm();
  const double slower = std::min(1.0, jog_.line_speed / std::max(tool_speed, 1e-12));
  state_.refusal = Refusal::kNone;
  state_.limit = 0;
  Knots knots;
  for (std::size_t i = 0; i < kAxes; ++i) {
    knots[i] = axis(i, i < kTable ? slower * wanted[i] : wanted[i], cycle, present);
  }
  return knots;
}

struct Jog::Attempt {
  Vector6 twist;
  Eigen::Isometry3d pose;
  Matrix6 jacobian;
  Knots knots{};  // of the joints
};

Vector6 Jog::wanted_twist(const Command& command) const {
  const auto& jog = command.jog;
  Vector6 twist;
  twist << at_most_one({jog[0], jog[1], jog[2]}) * jog_.line_speed,
      at_most_one({jog[3], jog[4], jog[5]}) * jog_.turn_speed;
  if (command.jog_frame == JogFrame::kTool) {
    twist.head<3>() = state_.turn * twist.head<3>();
    twist.tail<3>() = state_.turn * twist.tail<3>();
  }
  return twist;
}

Vector6 Jog::ramped(const Vector6& wanted, double cycle) const {
  Vector6 twist;
  twist << nearer(state_.twist.head<3>(), wanted.head<3>(), jog_.line_acceleration * cycle),
      nearer(state_.twist.tail<3>(), wanted.tail<3>(), jog_.turn_acceleration * cycle);
  return twist;
}

/// Where the joints get when the tool's twist becomes `twist` by the end of the cycle.
std::optional<Jog::Attempt> Jog::attempt(const Vector6& twist, double cycle, const Knots& present) const {
  const Eigen::Isometry3d here = Eigen::Translation3d(state_.position) * state_.turn;
  Attempt attempt{twist, along(here, state_.twist + twist, cycle / 2), {}, {}};
  const auto followed = follow(arm_, attempt.pose, positions(present));
  if (!followed) return std::nullopt;
  attempt.jacobian = followed->jacobian;
  const Vector6 rates = followed->jacobian.partialPivLu().solve(twist);
  for (std::size_t i = 0; i < kArmAxes; ++i) {
    attempt.knots[i] = {followed->position[i], rates[static_cast<int>(i)]};
  }
  return attempt;
}

/// The wanted twist, or as much of it as speed and acceleration of the joints allow.
std::optional<Jog::Attempt> Jog::within_limits(double cycle, const Command& command,
                                               const Knots& present) const {
  Vector6 wanted = wanted_twist(command);
  auto found = attempt(ramped(wanted, cycle), cycle, present);
  if (!found) return found;
  double ratio = 1;
  for (std::size_t i = 0; i < kArmAxes; ++i) {
    ratio = std::max(ratio, std::abs(found->knots[i].velocity) / (0.9 * limits_[i].max_speed));
  }
  if (ratio > 1) found = attempt(ramped(found->twist / ratio, cycle), cycle, present);
  if (!found) return found;
  double excess = 1;
  for (std::size_t i = 0; i < kArmAxes; ++i) {
    const double acceleration = greatest_acceleration(present[i], found->knots[i], cycle);
    excess = std::max(excess, acceleration / (0.8 * limits_[i].max_acceleration));
  }
  if (excess > 1) {
    found = attempt(state_.twist + (found->twist - state_.twist) / excess, cycle, present);
  }
  return found;
}

/// Whether the way ends here: blocks the jog and says why.
bool Jog::obstructed(const Attempt& attempt, double cycle, const Knots& present) {
  const double before = regularity(arm_.tool(positions(present)).jacobian);
  const double after = regularity(attempt.jacobian);
  // Away from a singular position is always allowed.
  if (after < 2 * kSmallestSingularValue && after < before * (1 - 1e-9)) {
    block(Refusal::kSingular, 0);
    return true;
  }
  for (std::size_t i = 0; i < kArmAxes; ++i) {
    const Knot& end = attempt.knots[i];
    const bool clear = clear_of_limits(end.velocity, present[i], limits_[i], cycle) == end.velocity;
    if (!clear || std::abs(end.velocity) > limits_[i].max_speed ||
        greatest_acceleration(present[i], end, cycle) > kAccelerationShare * limits_[i].max_acceleration) {
      block(clear ? Refusal::kSingular : Refusal::kPathOutOfLimits, clear ? 0 : static_cast<int>(i) + 1);
      return true;
    }
  }
  return false;
}

Knots Jog::cartesian(double cycle, const Command& command, const Knots& present) {
  if (state_.blocked && let_go(command) && at_rest(present)) enter(present);
  if (state_.blocked) return brake_together(cycle, limits_, present);
  const auto found = within_limits(cycle, command, present);
  if (!found) block(Refusal::kSingular, 0);
  if (!found || obstructed(*found, cycle, present)) return brake_together(cycle, limits_, present);
  state_.twist = found->twist;
  state_.position = found->pose.translation();
  state_.turn = Eigen::Quaterniond(found->pose.linear());
  Knots knots = found->knots;
  state_.refusal = Refusal::kNone;
  state_.limit = 0;
  const double table = command.jog[kTable] * jog_.joint_share * limits_[kTable].max_speed;
  knots[kTable] = axis(kTable, table, cycle, present);
  return knots;
}

}  // namespace robotcell::control
