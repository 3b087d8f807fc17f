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

}  // namespace

ServoController::ServoController(const Limits& limits, std::int64_t cycle_us, const Axes& start)
    : limits_(limits), cycle_us_(cycle_us) {
  state_.before = start;
  for (std::size_t i = 0; i < kAxes; ++i) state_.start[i] = state_.end[i] = {start[i], 0};
}

void ServoController::begin_cycle(std::int64_t now_us) {
  for (std::size_t i = 0; i < kAxes; ++i) state_.before[i] = state_.start[i].position;
  state_.start = state_.end;
  state_.start_us = now_us;
  state_.limit = 0;
}

void ServoController::advance(std::int64_t now_us, const Knots& end, std::int32_t limit) {
  begin_cycle(now_us);
  state_.end = end;
  state_.limit = limit;
}

void ServoController::cycle(std::int64_t now_us, const ServoCommand& command) {
  begin_cycle(now_us);
  for (std::size_t i = 0; i < kAxes; ++i) {
    bool limited = false;
    state_.end[i] = command.servo ? servo_knot(i, command.position[i], limited) : braking_knot(i);
    if (limited && state_.limit == 0) state_.limit = static_cast<std::int32_t>(i) + 1;
  }
}

Knot ServoController::servo_knot(std::size_t axis, double set_point, bool& limited) const {
  const AxisLimits& limit = limits_[axis];
  const Knot& start = state_.start[axis];
  const double duration = static_cast<double>(cycle_us_) * kSecondsPerMicrosecond;
  const double target = std::clamp(set_point, limit.min, limit.max);
  // Parabola through the last three knots, in differences so that an axis at rest stays exactly at rest.
  const double travel_before = start.position - state_.before[axis];
  Knot end{target, (3 * (target - start.position) - travel_before) / (2 * duration)};
  if (target != set_point) {
    limited = true;
    end.velocity = 0;
  }
  if (peak_speed(start, end, duration) > limit.max_speed * (1 + 1e-9)) {
    // A parabola of velocity with zero slope at the end of the cycle stays within its two end values.
    const double wanted = (3 * (target - start.position) / duration - start.velocity) / 2;
    end.velocity = std::clamp(wanted, -limit.max_speed, limit.max_speed);
    if (end.velocity != wanted) {
      end.position = start.position + duration * (2 * end.velocity + start.velocity) / 3;
      limited = true;
    }
  }
  return end;
}

Knot ServoController::braking_knot(std::size_t axis) const {
  const Knot& start = state_.start[axis];
  const double duration = static_cast<double>(cycle_us_) * kSecondsPerMicrosecond;
  const double drop = limits_[axis].max_acceleration * duration;
  const double velocity = start.velocity - std::clamp(start.velocity, -drop, drop);
  const double end = start.position + duration * (start.velocity + velocity) / 2;
  const double target = std::clamp(end, limits_[axis].min, limits_[axis].max);
  return {target, target == end ? velocity : 0};
}

Knots ServoController::sample(std::int64_t time_us) const {
  const double duration = static_cast<double>(cycle_us_) * kSecondsPerMicrosecond;
  const double s = static_cast<double>(time_us - state_.start_us) / static_cast<double>(cycle_us_);
  if (s >= 1) return state_.end;
  Knots knots;
  for (std::size_t i = 0; i < kAxes; ++i) {
    knots[i] = cubic_between(state_.start[i], state_.end[i], duration, s);
    const double inside = std::clamp(knots[i].position, limits_[i].min, limits_[i].max);
    if (inside != knots[i].position) knots[i] = {inside, 0};  // hard stop
  }
  return knots;
}

bool ServoController::moving(std::int64_t time_us) const {
  if (time_us >= state_.start_us + cycle_us_) {
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
