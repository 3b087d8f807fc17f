#include "fmu/model/axes_state.h"

#include <algorithm>

#include "fmu/control/cubic.h"

namespace robotcell {
namespace {

constexpr double kSecondsPerTick = 1e-6;

bool comes_before(const TimedAxes& state, std::int64_t time_us) { return state.time_us < time_us; }

}  // namespace

AxesState between(const TimedAxes& from, const TimedAxes& to, std::int64_t time_us) {
  if (time_us == to.time_us) return to.axes;
  if (time_us == from.time_us) return from.axes;
  const auto span = static_cast<double>(to.time_us - from.time_us);
  const double share = static_cast<double>(time_us - from.time_us) / span;
  AxesState state;
  for (std::size_t i = 0; i < kAxes; ++i) {
    const auto knot =
        control::cubic_between({from.axes.position[i], from.axes.rate[i]},
                               {to.axes.position[i], to.axes.rate[i]}, span * kSecondsPerTick, share);
    state.position[i] = knot.position;
    state.rate[i] = knot.velocity;
  }
  return state;
}

void AxesHistory::add(const TimedAxes& state) {
  states_.push_back(state);
  // One state at the far end of the span, or before it, must stay.
  const std::int64_t oldest = state.time_us - span_us_;
  const auto needed = std::lower_bound(states_.begin(), states_.end(), oldest + 1, comes_before);
  if (needed - states_.begin() > 1) states_.erase(states_.begin(), needed - 1);
}

AxesState AxesHistory::at(std::int64_t time_us) const {
  const auto next = std::lower_bound(states_.begin(), states_.end(), time_us, comes_before);
  if (next == states_.begin()) return next->axes;
  if (next == states_.end()) return states_.back().axes;
  return between(*(next - 1), *next, time_us);
}

}  // namespace robotcell
