// The axes that the controller moves: their limits, and where they are at an instant.
#pragma once

#include <array>
#include <cstddef>

#include "fmu/control/cubic.h"

namespace robotcell::control {

constexpr int kArmAxes = 6;
constexpr int kAxes = kArmAxes + 1;  // the arm's joints, then the table
constexpr double kSecondsPerTick = 1e-6;

/// One number per axis.
using Axes = std::array<double, kAxes>;
using Knots = std::array<Knot, kAxes>;

/// Limits of one axis; an endless axis has infinite `min` and `max`.
struct AxisLimits {
  double min = 0, max = 0;      // rad
  double max_speed = 0;         // rad/s
  double max_acceleration = 0;  // rad/s^2; also with which the axis brakes
  double max_jerk = 0;          // rad/s^3, of programmed motion at full monitor speed
};

using Limits = std::array<AxisLimits, kAxes>;

}  // namespace robotcell::control
