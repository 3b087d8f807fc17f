// Axes of the controller: limits and one value per axis.
#pragma once

#include <array>
#include <cstddef>

#include "fmu/control/cubic.h"
#include "fmu/control/time_units.h"

namespace robotcell::control {

/// The axes are the joints of the arm, the table at a fixed index, then further axes. Those that a cell does
/// not have stand still at 0.
constexpr int kMaxJoints = 8;
constexpr int kMaxFurtherAxes = 3;
constexpr int kAxes = kMaxJoints + 1 + kMaxFurtherAxes;
constexpr std::size_t kTableAxis = kMaxJoints;
constexpr std::size_t kFirstFurtherAxis = kTableAxis + 1;

/// One value per axis.
using Axes = std::array<double, kAxes>;
using Knots = std::array<Knot, kAxes>;

inline Axes positions(const Knots& knots) {
  Axes axes;
  for (std::size_t i = 0; i < kAxes; ++i) axes[i] = knots[i].position;
  return axes;
}

/// Limits of one axis; a continuous axis has infinite `min` and `max`.
struct AxisLimits {
  double min = 0, max = 0;      // rad, or m where the axis slides
  double max_speed = 0;         // rad/s, m/s
  double max_acceleration = 0;  // rad/s^2, m/s^2; used for braking, too
  double max_jerk = 0;          // rad/s^3, m/s^3, of programmed moves at full monitor speed
};

using Limits = std::array<AxisLimits, kAxes>;

}  // namespace robotcell::control
