// Axes of the controller: limits and one value per axis.
#pragma once

#include <array>
#include <cstddef>

#include "fmu/control/cubic.h"
#include "fmu/control/time_units.h"

namespace robotcell::control {

/// The axes are the joints of the arm, then the table at a fixed index. Axes between the last joint of an arm
/// and the table stand still at 0.
constexpr int kMaxJoints = 8;
constexpr int kAxes = kMaxJoints + 1;
constexpr std::size_t kTableAxis = kMaxJoints;

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
  double min = 0, max = 0;      // rad
  double max_speed = 0;         // rad/s
  double max_acceleration = 0;  // rad/s^2; used for braking, too
  double max_jerk = 0;          // rad/s^3, of programmed moves at full monitor speed
};

using Limits = std::array<AxisLimits, kAxes>;

}  // namespace robotcell::control
