// Segments of programs for the arm of arm_model.h.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "tests/fmu/arm_model.h"

namespace robotcell::testing {

/// Joint i at time t of a motion of `duration` seconds: a wave that begins and ends at home with neither
/// speed nor acceleration.
inline double wave(std::size_t joint, double t, double duration) {
  const double x = t / duration;
  const double envelope = 16 * x * x * (1 - x) * (1 - x);
  return home()[joint] +
         0.4 * envelope * std::sin(2 * 3.14159265358979 * x * (1 + 0.5 * static_cast<double>(joint)));
}

/// Waves of all joints; `offset` displaces the first one.
inline std::shared_ptr<const control::ProgramSegment> waves(double duration, double offset = 0) {
  std::vector<Axes> points;
  const auto last = static_cast<int>(std::lround(duration / kCycleSeconds));
  for (int k = 0; k <= last; ++k) {
    Axes point = home();
    for (std::size_t i = 0; i < kArmJoints; ++i) point[i] = wave(i, k * kCycleSeconds, duration);
    point[0] += offset;
    points.push_back(point);
  }
  return std::make_shared<const control::ProgramSegment>(
      control::interpolated_segment(1, kCycleSeconds, points));
}

/// One axis moves by `travel` at the constant speed `travel` / `duration`, after and before smooth ramps of
/// half a second.
inline std::shared_ptr<const control::ProgramSegment> straight(std::size_t axis, double travel,
                                                               double duration) {
  const double ramp = 0.5;
  const auto travelled = [](double u) {
    return u * u * u * (1 - u / 2);
  };  // of a ramp, in its speed and time
  std::vector<Axes> points;
  const auto last = static_cast<int>(std::ceil((duration + ramp) / kCycleSeconds));
  for (int k = 0; k <= last; ++k) {
    const double t = k * kCycleSeconds;
    const double rising = std::min(1.0, t / ramp);
    const double falling = std::min(1.0, std::max(0.0, (t - duration) / ramp));
    const double cruise = std::min(duration, std::max(ramp, t)) - ramp;
    Axes point = home();
    point[axis] += travel / duration * (ramp * (travelled(rising) + falling - travelled(falling)) + cruise);
    points.push_back(point);
  }
  return std::make_shared<const control::ProgramSegment>(
      control::interpolated_segment(1, kCycleSeconds, points));
}

inline void start(Drive& drive, std::shared_ptr<const control::ProgramSegment> segment) {
  drive.command.mode = control::Mode::kProgram;
  drive.command.segment = std::move(segment);
  ++drive.command.start;
}

}  // namespace robotcell::testing
