// Axis motion between knots one controller cycle apart: streamed set-points, braking, or knots from a
// planner.
#pragma once

#include <cstdint>

#include "fmu/control/axis.h"

namespace robotcell::control {

struct ServoCommand {
  bool servo = false;  // true: follow `position`; false: brake and hold
  Axes position{};     // rad
};

/// Complete state of the servo controller.
struct ServoState {
  std::int64_t start_us = 0;  // of the current cycle
  Axes set_point{};           // at the end of the current cycle, within the position limits
  Axes set_point_before{};    // one cycle before
  Knots start{};
  Knots end{};
  double duration_us = 0;  // from start to end, at most a cycle: a programmed motion may end within one
  std::int32_t limit = 0;  // first axis kept from its set-point, counted from 1; 0: none
};

/// Latches a command every cycle and reaches it one cycle later.
///
/// Between knots an axis follows a cubic with continuous velocity. The velocity at a set-point is that of the
/// parabola through the last three, so that a quadratic trajectory is reproduced exactly, one cycle late.
/// Where no cubic within the limits of speed and acceleration reaches the set-point, the axis approaches it
/// with constant acceleration in each cycle and lags behind until it has caught up. Set-points are clamped to
/// the position limits, and an axis always remains able to stop before these.
class ServoController {
 public:
  ServoController(const Limits& limits, std::int64_t cycle_us, const Axes& start);

  /// Call at every multiple of the cycle, before sampling a later instant.
  void cycle(std::int64_t now_us, const ServoCommand& command);

  /// Starts a cycle towards knots computed elsewhere; `limit` as in ServoState.
  void advance(std::int64_t now_us, const Knots& end, std::int32_t limit) {
    advance(now_us, end, limit, duration_);
  }
  /// The axes are at rest at the knots after `duration` seconds, at most a cycle, and stay there.
  void advance(std::int64_t now_us, const Knots& end, std::int32_t limit, double duration);

  /// Set-points of position and velocity at an instant of the current cycle.
  Knots sample(std::int64_t time_us) const;

  bool moving(std::int64_t time_us) const;

  const ServoState& state() const { return state_; }
  void restore(const ServoState& state) { state_ = state; }

 private:
  Knot servo_knot(std::size_t axis, double target) const;
  bool reaches(std::size_t axis, const Knot& set_point, Knot& end) const;
  bool can_stop_within_limits(std::size_t axis, const Knot& end) const;
  Knot approach_knot(std::size_t axis, const Knot& set_point) const;
  Knot braking_knot(std::size_t axis) const;
  void begin_cycle(std::int64_t now_us);
  void shift_set_points(std::size_t axis, double next);

  Limits limits_;
  std::int64_t cycle_us_;
  double duration_;  // s, of a cycle
  ServoState state_;
};

}  // namespace robotcell::control
