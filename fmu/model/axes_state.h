// Positions and rates of the axes at one instant, interpolated, and their recent history.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "fmu/control/axis.h"

namespace robotcell {

using control::kAxes;
using control::kFirstFurtherAxis;
using control::kMaxFurtherAxes;
using control::kMaxJoints;
using control::kTableAxis;

/// Positions and rates of all axes at one instant (rad, rad/s; m, m/s where they slide).
struct AxesState {
  std::array<double, kAxes> position{};
  std::array<double, kAxes> rate{};
};

struct TimedAxes {
  std::int64_t time_us = 0;
  AxesState axes;
};

/// Cubic Hermite interpolation between two states; exact at both ends.
AxesState interpolate(const TimedAxes& from, const TimedAxes& to, std::int64_t time_us);

/// The states of a recent span of time, for sensors with latency.
class AxesHistory {
 public:
  explicit AxesHistory(std::int64_t span_us) : span_us_(span_us) {}

  /// Appends a state, later than all before, and drops those older than the span.
  void add(const TimedAxes& state);

  /// State at an instant not later than the last one; the first state for earlier instants.
  AxesState at(std::int64_t time_us) const;

  const std::vector<TimedAxes>& states() const { return states_; }
  void restore(const std::vector<TimedAxes>& states) { states_ = states; }

 private:
  std::int64_t span_us_;
  std::vector<TimedAxes> states_;
};

}  // namespace robotcell
