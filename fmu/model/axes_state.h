// Positions and rates of the axes: at an instant, between two, and in the past.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "fmu/model/cell_values.h"

namespace robotcell {

/// Positions and rates of all axes at one instant (rad, rad/s).
struct AxesState {
  std::array<double, kAxes> position{};
  std::array<double, kAxes> rate{};
};

struct TimedAxes {
  std::int64_t time_us = 0;
  AxesState axes;
};

/// Along the cubic through positions and rates of two states; those themselves at their instants.
AxesState between(const TimedAxes& from, const TimedAxes& to, std::int64_t time_us);

/// The states of the last while, as old as anybody will ask for.
class AxesHistory {
 public:
  explicit AxesHistory(std::int64_t span_us) : span_us_(span_us) {}

  /// Adds a state, later than all before, and forgets what is older than the span.
  void add(const TimedAxes& state);

  /// At an instant not later than the last state; before the first, the first.
  AxesState at(std::int64_t time_us) const;

  const std::vector<TimedAxes>& states() const { return states_; }
  void restore(const std::vector<TimedAxes>& states) { states_ = states; }

 private:
  std::int64_t span_us_;
  std::vector<TimedAxes> states_;
};

}  // namespace robotcell
