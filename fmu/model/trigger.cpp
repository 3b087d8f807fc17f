#include "fmu/model/trigger.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "fmu/model/random.h"

namespace robotcell {
namespace {

constexpr double kTicksPerSecond = 1e6;
constexpr std::size_t kMostPending = 65536;
/// Share of an interval granted to rounding, so that an exact multiple does not come a microsecond late.
constexpr double kRounding = 1e-9;

std::int64_t ticks(double seconds) { return std::llround(seconds * kTicksPerSecond); }

bool finished(const PendingRecord& record) { return record.measured && record.lit; }

bool counts(TriggerMode mode) { return mode != TriggerMode::kOff && mode != TriggerMode::kRequest; }

TriggerMode mode_of(const TriggerCommand& command) { return static_cast<TriggerMode>(command.mode); }

double interval(const TriggerCommand& command) {
  switch (mode_of(command)) {
    case TriggerMode::kTime:
      return command.period;
    case TriggerMode::kTableAngle:
      return command.angle;
    case TriggerMode::kPathDistance:
      return command.distance;
    default:
      return 0;
  }
}

void check(const CellInputs& inputs) {
  const TriggerMode mode = mode_of(inputs.trigger);
  if (inputs.exposure < 0) throw std::invalid_argument("command.exposure must not be negative");
  if (mode == TriggerMode::kTime && ticks(inputs.trigger.period) < 1) {
    throw std::invalid_argument("command.trigger.period must be at least 1 microsecond");
  }
  if (counts(mode) && interval(inputs.trigger) <= 0) {
    throw std::invalid_argument(mode == TriggerMode::kTableAngle
                                    ? "command.trigger.angle must be positive"
                                    : "command.trigger.distance must be positive");
  }
}

}  // namespace

Trigger::Trigger(const CellLayout& layout, const TriggerErrors& errors, std::uint64_t key)
    : layout_(layout), errors_(errors), key_(key), state_(layout) {
  if (errors.latency < 0) throw std::invalid_argument("as_built.trigger.latency must not be negative");
  if (errors.jitter < 0) throw std::invalid_argument("as_built.trigger.jitter must not be negative");
}

void Trigger::command(const CellInputs& inputs, std::int64_t now_us, const MotionView& view) {
  check(inputs);
  const TriggerCommand before = state_.command;
  state_.command = inputs.trigger;
  state_.segment = inputs.segment;
  state_.exposure = inputs.exposure;
  const TriggerMode mode = mode_of(inputs.trigger);
  if (inputs.trigger.mode != before.mode || interval(inputs.trigger) != interval(before)) {
    enter(now_us, view);
    if (counts(mode)) fire(now_us);
  }
  if (mode != TriggerMode::kOff && inputs.trigger.request > before.request) {
    fire(now_us);
    if (counts(mode)) --state_.fired_since_entry;  // an exposure on demand does not shift the regular ones
  }
}

void Trigger::enter(std::int64_t now_us, const MotionView& view) {
  state_.entered_us = now_us;
  state_.fired_since_entry = 0;
  state_.entry_angle = view.table_angle(now_us);
  state_.path = 0;
  const Eigen::Vector3d here = view.sensor_in_table(now_us);
  state_.path_reference = {here.x(), here.y(), here.z()};
}

double Trigger::path_length(std::int64_t time_us, const MotionView& view) const {
  const Eigen::Map<const Eigen::Vector3d> reference(state_.path_reference.data());
  return state_.path + (view.sensor_in_table(time_us) - reference).norm();
}

bool Trigger::due(std::int64_t time_us, const MotionView& view) const {
  const auto n = static_cast<double>(state_.fired_since_entry);
  switch (mode_of(state_.command)) {
    case TriggerMode::kTime:
      return time_us >= state_.entered_us + ticks(n * state_.command.period);
    case TriggerMode::kTableAngle:
      return std::abs(view.table_angle(time_us) - state_.entry_angle) >=
             (n - kRounding) * state_.command.angle;
    case TriggerMode::kPathDistance:
      return path_length(time_us, view) >= (n - kRounding) * state_.command.distance;
    default:
      return false;
  }
}

void Trigger::watch(std::int64_t from_us, std::int64_t to_us, bool step_ends, const MotionView& view) {
  while (due(to_us, view)) {
    std::int64_t early = from_us;
    std::int64_t late = to_us;
    while (late - early > 1) {
      const std::int64_t middle = early + (late - early) / 2;
      (due(middle, view) ? late : early) = middle;
    }
    fire(late);
  }
  if (step_ends && mode_of(state_.command) == TriggerMode::kPathDistance) {
    state_.path = path_length(to_us, view);
    const Eigen::Vector3d here = view.sensor_in_table(to_us);
    state_.path_reference = {here.x(), here.y(), here.z()};
  }
}

/// The light comes late by the latency, give or take the jitter, but never before the sensor fired.
std::int64_t Trigger::light_instant(std::int64_t fired_us, std::int64_t middle_us) const {
  double delay = errors_.latency;
  if (errors_.jitter > 0) delay += errors_.jitter * normal(key_ + static_cast<std::uint64_t>(state_.count));
  return std::max(fired_us, middle_us + ticks(delay));
}

void Trigger::fire(std::int64_t time_us) {
  if (state_.pending.size() >= kMostPending) {
    throw std::runtime_error(
        "65536 trigger records wait: one is taken per communication step, use smaller steps");
  }
  ++state_.count;
  ++state_.fired_since_entry;
  PendingRecord pending{TriggerRecord(layout_)};
  pending.middle_us = time_us + ticks(state_.exposure) / 2;
  pending.light_us = light_instant(time_us, pending.middle_us);
  pending.record.index = state_.count;
  pending.record.segment = state_.segment;
  pending.record.time = static_cast<double>(pending.middle_us) / kTicksPerSecond;
  pending.record.exposure = state_.exposure;
  state_.pending.push_back(pending);
  ++state_.open;
}

void Trigger::latch(std::int64_t to_us, const MotionView& view) {
  if (state_.open == 0) return;
  state_.open = 0;
  for (PendingRecord& pending : state_.pending) {
    if (!pending.measured && pending.middle_us <= to_us) {
      pending.record.measured = view.measurement(pending.middle_us);
      pending.measured = true;
    }
    if (!pending.lit && pending.light_us <= to_us) {
      view.write_truth(pending.light_us, pending.record.truth);
      pending.lit = true;
    }
    if (!finished(pending)) ++state_.open;
  }
}

bool Trigger::show_next() {
  if (state_.pending.empty() || !finished(state_.pending.front())) return false;
  state_.shown = state_.pending.front().record;
  state_.pending.pop_front();
  return true;
}

std::int64_t Trigger::next_ready() const {
  if (state_.pending.empty()) return std::numeric_limits<std::int64_t>::max();
  return std::max(state_.pending.front().middle_us, state_.pending.front().light_us);
}

std::int32_t Trigger::queued() const {
  const auto open = std::find_if_not(state_.pending.begin(), state_.pending.end(), finished);
  return static_cast<std::int32_t>(open - state_.pending.begin());
}

}  // namespace robotcell
