#include "fmu/control/servo_controller.h"

#include <algorithm>
#include <cmath>

#include "fmu/control/time_units.h"

namespace robotcell::control {
namespace {

/// Largest absolute speed along the cubic between two knots.
double peak_speed(const Knot& start, const Knot& end, double duration) {
  double peak = std::max(std::abs(start.velocity), std::abs(end.velocity));
  const double travel = end.position - start.position;
  const double quadratic = 3 * travel - (2 * start.velocity + end.velocity) * duration;
  const double cubic = (start.velocity + end.velocity) * duration - 2 * travel;
  const double s = cubic != 0 ? -quadratic / (3 * cubic) : -1;
  if (s > 0 && s < 1) peak = std::max(peak, std::abs(cubic_between(start, end, duration, s).velocity));
  return peak;
}

/// Accelerates by at most `step` (rad/s) in each cycle of `duration` seconds.
struct Brake {
  double step, duration;

  /// Distance travelled while braking from `speed`: full steps, then a smaller one.
  double stopping_distance(double speed) const {
    const double full = std::floor(std::abs(speed) / step);
    const double rest = std::abs(speed) - full * step;
    return duration * ((std::abs(speed) + rest) * full + rest) / 2;
  }

  /// Speed u after a cycle from which an axis stops at `distance` + u * duration / 2. The discrete form of
  /// sqrt(2 a d): with k full braking cycles to follow, distance = duration (k + 1) (u - k step / 2).
  double approach_speed(double distance) const {
    const double q = std::abs(distance) / (step * duration);
    const double cycles = std::floor((std::sqrt(1 + 8 * q) - 1) / 2);
    return std::copysign(std::abs(distance) / (duration * (cycles + 1)) + cycles * step / 2, distance);
  }
};

/// Velocity of a stream at its last set-point: that of the parabola through the last three, or, where they
/// are too far from each other for the acceleration limit, the smaller one of the last two mean velocities.
double stream_velocity(double change, double change_before, const Brake& brake) {
  if (std::abs(change - change_before) <= brake.step * brake.duration * (1 + 1e-9)) {
    return (3 * change - change_before) / (2 * brake.duration);
  }
  if (change * change_before <= 0) return 0;
  const double smaller = std::min(std::abs(change), std::abs(change_before));
  return std::copysign(smaller, change) / brake.duration;
}

/// Largest distance to a position limit; finite for a continuous axis.
constexpr double kFarLimit = 1e6;
/// A set-point counts as reached up to this distance (rad).
constexpr double kReached = 1e-9;

}  // namespace

ServoController::ServoController(const Limits& limits, std::int64_t cycle_us, const Axes& start)
    : limits_(limits),
      cycle_us_(cycle_us),
      duration_(static_cast<double>(cycle_us) * kSecondsPerMicrosecond) {
  state_.duration_us = static_cast<double>(cycle_us);
  state_.set_point = state_.set_point_before = start;
  for (std::size_t i = 0; i < kAxes; ++i) state_.start[i] = state_.end[i] = {start[i], 0};
}

void ServoController::begin_cycle(std::int64_t now_us) {
  state_.start = state_.end;
  state_.start_us = now_us;
  state_.duration_us = static_cast<double>(cycle_us_);
  state_.limit = 0;
}

void ServoController::advance(std::int64_t now_us, const Knots& end, std::int32_t limit, double duration) {
  begin_cycle(now_us);
  state_.end = end;
  if (duration < duration_) state_.duration_us = duration * kMicrosecondsPerSecond;
  state_.limit = limit;
  for (std::size_t i = 0; i < kAxes; ++i) shift_set_points(i, end[i].position);
}

void ServoController::shift_set_points(std::size_t axis, double next) {
  state_.set_point_before[axis] = state_.set_point[axis];
  state_.set_point[axis] = next;
}

void ServoController::cycle(std::int64_t now_us, const ServoCommand& command) {
  begin_cycle(now_us);
  for (std::size_t i = 0; i < kAxes; ++i) {
    if (!command.servo) {
      state_.end[i] = braking_knot(i);
      shift_set_points(i, state_.end[i].position);
      continue;
    }
    const double target = std::clamp(command.position[i], limits_[i].min, limits_[i].max);
    state_.end[i] = servo_knot(i, target);
    shift_set_points(i, target);
    const bool reached = std::abs(state_.end[i].position - command.position[i]) <= kReached;
    if (!reached && state_.limit == 0) state_.limit = static_cast<std::int32_t>(i) + 1;
  }
}

Knot ServoController::servo_knot(std::size_t axis, double target) const {
  const AxisLimits& limit = limits_[axis];
  const Brake brake{limit.max_acceleration * duration_, duration_};
  const double before = state_.set_point[axis];
  const double velocity =
      std::clamp(stream_velocity(target - before, before - state_.set_point_before[axis], brake),
                 -limit.max_speed, limit.max_speed);
  Knot end;
  return reaches(axis, {target, velocity}, end) ? end : approach_knot(axis, {target, velocity});
}

/// Whether a cubic within all limits reaches the position of a set-point in one cycle; `end` is its end. An
/// axis that leaves its set-points must also arrive with their velocity, otherwise it would overshoot.
bool ServoController::reaches(std::size_t axis, const Knot& set_point, Knot& end) const {
  const AxisLimits& limit = limits_[axis];
  const Knot& start = state_.start[axis];
  const Brake brake{limit.max_acceleration * duration_, duration_};
  const double mean = (set_point.position - start.position) / duration_;
  // End velocities for which the acceleration at both ends of the cubic is within its limit.
  const double lowest = std::max({3 * mean - 2 * start.velocity - brake.step / 2,
                                  (6 * mean - 2 * start.velocity - brake.step) / 4, -limit.max_speed});
  const double highest = std::min({3 * mean - 2 * start.velocity + brake.step / 2,
                                   (6 * mean - 2 * start.velocity + brake.step) / 4, limit.max_speed});
  if (lowest > highest) return false;
  const bool follows = start.position == state_.set_point[axis];
  // The velocity of the stream, or that of a cubic whose acceleration ends at zero: it has no peak of speed.
  for (const double wanted : {set_point.velocity, (3 * mean - start.velocity) / 2}) {
    end = {set_point.position, std::clamp(wanted, lowest, highest)};
    if (!follows && end.velocity != set_point.velocity) continue;
    if (peak_speed(start, end, duration_) > limit.max_speed * (1 + 1e-9)) continue;
    if (can_stop_within_limits(axis, end)) return true;
  }
  return false;
}

/// Whether the cubic to `end` and the braking path from there are within the position limits.
bool ServoController::can_stop_within_limits(std::size_t axis, const Knot& end) const {
  const AxisLimits& limit = limits_[axis];
  const Knot& start = state_.start[axis];
  const Brake brake{limit.max_acceleration * duration_, duration_};
  const double stop = end.position + std::copysign(brake.stopping_distance(end.velocity), end.velocity);
  // A cubic is within the hull of its Bezier points.
  const double first = start.position + start.velocity * duration_ / 3;
  const double second = end.position - end.velocity * duration_ / 3;
  const auto [low, high] = std::minmax({stop, first, second});
  return low >= limit.min && high <= limit.max;
}

/// A cycle of constant acceleration towards a moving set-point, in the shortest time within all limits.
Knot ServoController::approach_knot(std::size_t axis, const Knot& set_point) const {
  const AxisLimits& limit = limits_[axis];
  const Knot& start = state_.start[axis];
  const Brake brake{limit.max_acceleration * duration_, duration_};
  const double coasted = start.position + duration_ * start.velocity / 2;
  double velocity = set_point.velocity +
                    brake.approach_speed(set_point.position - coasted - duration_ * set_point.velocity / 2);
  velocity = std::min(velocity, brake.approach_speed(std::min(limit.max - coasted, kFarLimit)));
  velocity = std::max(velocity, brake.approach_speed(std::max(limit.min - coasted, -kFarLimit)));
  velocity = std::clamp(velocity, -limit.max_speed, limit.max_speed);
  velocity = std::clamp(velocity, start.velocity - brake.step, start.velocity + brake.step);
  return {start.position + duration_ * (start.velocity + velocity) / 2, velocity};
}

Knot ServoController::braking_knot(std::size_t axis) const {
  const Knot& start = state_.start[axis];
  const double drop = limits_[axis].max_acceleration * duration_;
  const double velocity = start.velocity - std::clamp(start.velocity, -drop, drop);
  const double end = start.position + duration_ * (start.velocity + velocity) / 2;
  const double target = std::clamp(end, limits_[axis].min, limits_[axis].max);
  return {target, target == end ? velocity : 0};
}

Knots ServoController::sample(std::int64_t time_us) const {
  const double s = static_cast<double>(time_us - state_.start_us) / state_.duration_us;
  if (s >= 1) return state_.end;
  const double duration = state_.duration_us * kSecondsPerMicrosecond;
  Knots knots;
  for (std::size_t i = 0; i < kAxes; ++i) {
    knots[i] = cubic_between(state_.start[i], state_.end[i], duration, s);
    const double inside = std::clamp(knots[i].position, limits_[i].min, limits_[i].max);
    if (inside != knots[i].position) knots[i] = {inside, 0};  // hard stop
  }
  return knots;
}

bool ServoController::moving(std::int64_t time_us) const {
  if (static_cast<double>(time_us - state_.start_us) >= state_.duration_us) {
    return std::any_of(state_.end.begin(), state_.end.end(), [](const Knot& k) { return k.velocity != 0; });
  }
  for (std::size_t i = 0; i < kAxes; ++i) {
    const Knot& start = state_.start[i];
    const Knot& end = state_.end[i];
    if (start.velocity != 0 || end.velocity != 0 || start.position != end.position) return true;
  }
  return false;
}

}  // namespace robotcell::control
