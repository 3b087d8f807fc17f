#include "fmu/model/axes_state.h"

#include <algorithm>

#include "fmu/control/cubic.h"
#include "fmu/control/time_units.h"

namespace robotcell {
namespace {

bool is_before(const TimedAxes& state, std::int64_t time_us) { return state.time_us < time_us; }

}  // namespace

AxesState interpolate(const TimedAxes& from, const TimedAxes& to, std::int64_t time_us) {
  if (time_us == to.time_us) return to.axes;
  if (time_us == from.time_us) return from.axes;
  const auto span = static_cast<double>(to.time_us - from.time_us);
  const double fraction = static_cast<double>(time_us - from.time_us) / span;
  AxesState state;
  for (std::size_t i = 0; i < kAxes; ++i) {
    const auto knot = control::cubic_between({from.axes.position[i], from.axes.rate[i]},
                                             {to.axes.position[i], to.axes.rate[i]},
                                             span * kSecondsPerMicrosecond, fraction);
    state.position[i] = knot.position;
    state.rate[i] = knot.velocity;
  }
  return state;
}

void AxesHistory::add(const TimedAxes& state) {
  states_.push_back(state);
  // One state at or before the end of the span must stay, for interpolation.
  const std::int64_t span_start = state.time_us - span_us_;
  const auto first_needed = std::lower_bound(states_.begin(), states_.end(), span_start + 1, is_before);
  if (first_needed - states_.begin() > 1) states_.erase(states_.begin(), first_needed - 1);
}

AxesState AxesHistory::at(std::int64_t time_us) const {
  const auto next = std::lower_bound(states_.begin(), states_.end(), time_us, is_before);
  if (next == states_.begin()) return next->axes;
  if (next == states_.end()) return states_.back().axes;
  return interpolate(*(next - 1), *next, time_us);
}

}  // namespace robotcell
