// The robot controller: turns streamed set-points into smooth axis motion. Knows neither the dynamics nor
// FMI.
#pragma once

#include <array>
#include <cstdint>

#include "fmu/control/cubic.h"

namespace robotcell::control {

constexpr int kAxes = 7;

/// Limits of one axis; an endless axis has infinite `min` and `max`.
struct AxisLimits {
  double min = 0, max = 0;      // rad
  double max_speed = 0;         // rad/s
  double max_acceleration = 0;  // rad/s^2, with which the axis brakes on hold
};

struct Command {
  bool servo = false;                    // false: brake and hold
  std::array<double, kAxes> position{};  // rad
};

using Knots = std::array<Knot, kAxes>;

/// All that the controller remembers.
struct ServoState {
  std::int64_t start_us = 0;           // of the cycle that runs
  std::array<double, kAxes> before{};  // positions one cycle before `start`
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
  ServoController(const std::array<AxisLimits, kAxes>& limits, std::int64_t cycle_us,
                  const std::array<double, kAxes>& start);

  /// To be called at every multiple of the cycle, before anything is sampled behind it.
  void cycle(std::int64_t now_us, const Command& command);

  /// Where the axes are to be, and how fast, at an instant of the running cycle.
  Knots sample(std::int64_t time_us) const;

  bool moving(std::int64_t time_us) const;

  const ServoState& state() const { return state_; }
  void restore(const ServoState& state) { state_ = state; }

 private:
  Knot servo_knot(std::size_t axis, double set_point, bool& limited) const;
  Knot braking_knot(std::size_t axis) const;

  std::array<AxisLimits, kAxes> limits_;
  std::int64_t cycle_us_;
  ServoState state_;
};

}  // namespace robotcell::control
