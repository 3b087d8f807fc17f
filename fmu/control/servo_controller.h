// Axis motion from knot to knot, one controller cycle apart: streamed set-points, braking, or given knots.
#pragma once

#include <cstdint>

#include "fmu/control/axis.h"

namespace robotcell::control {

struct ServoCommand {
  bool servo = false;  // false: brake and hold
  Axes position{};     // rad
};

/// All that the controller remembers.
struct ServoState {
  std::int64_t start_us = 0;  // of the cycle that runs
  Axes before{};              // positions one cycle before `start`
  Knots start{};
  Knots end{};
  std::int32_t limit = 0;  // 1..7: first axis that was kept from its set-point; 0: none
};

/// Latches a command every cycle and reaches it one cycle later.
///
/// Between the knots an axis follows a cubic with continuous velocity; the velocity at a new knot is that of
/// the parabola through the last three, so that a quadratic trajectory is reproduced exactly, one cycle late.
/// Set-points are clamped to the position limits. A cubic that would exceed the speed limit is replaced by a
/// parabola that does not, and the axis falls behind its set-point.
class ServoController {
 public:
  ServoController(const Limits& limits, std::int64_t cycle_us, const Axes& start);

  /// To be called at every multiple of the cycle, before anything is sampled behind it.
  void cycle(std::int64_t now_us, const ServoCommand& command);

  /// The same with knots that somebody else has worked out; `limit` as in the state.
  void advance(std::int64_t now_us, const Knots& end, std::int32_t limit);

  /// Where the axes are to be, and how fast, at an instant of the running cycle.
  Knots sample(std::int64_t time_us) const;

  bool moving(std::int64_t time_us) const;

  const ServoState& state() const { return state_; }
  void restore(const ServoState& state) { state_ = state; }

 private:
  Knot servo_knot(std::size_t axis, double set_point, bool& limited) const;
  Knot braking_knot(std::size_t axis) const;
  void begin_cycle(std::int64_t now_us);

  Limits limits_;
  std::int64_t cycle_us_;
  ServoState state_;
};

}  // namespace robotcell::control
