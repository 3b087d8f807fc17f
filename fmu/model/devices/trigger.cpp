#include "fmu/model/devices/trigger.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "fmu/control/time_units.h"
#include "fmu/model/cell_values.h"
#include "fmu/model/random.h"

namespace robotcell {
namespace {

constexpr std::size_t kMaxPending = 65536;
constexpr double kMaxIntervals = 1e18;  // within an integer of 64 bits
/// Relative tolerance of an interval, so that an exact multiple is not rounded up by a microsecond.
constexpr double kIntervalTolerance = 1e-9;
/// s of the path clock: exposures fire at whole microseconds, one at the end of the gate included.
constexpr double kGateRounding = 1e-6;

std::int64_t microseconds(double seconds) { return std::llround(seconds * kMicrosecondsPerSecond); }

bool is_complete(const PendingRecord& record) { return record.measured && record.illuminated; }

bool is_periodic(TriggerMode mode) { return mode != TriggerMode::kOff && mode != TriggerMode::kRequest; }

/// Whether a mode follows the segments of programs.
bool has_gate(TriggerMode mode) { return is_periodic(mode) && mode != TriggerMode::kBeltTravel; }

/// First instant in (lower, upper] at which a condition holds that holds at `upper`.
template <class Condition>
std::int64_t first_instant(std::int64_t lower, std::int64_t upper, const Condition& holds) {
  while (upper - lower > 1) {
    const std::int64_t middle = lower + (upper - lower) / 2;
    (holds(middle) ? upper : lower) = middle;
  }
  return upper;
}

TriggerMode commanded_mode(const TriggerCommand& command) { return static_cast<TriggerMode>(command.mode); }

double interval(const TriggerCommand& command) {
  switch (commanded_mode(command)) {
    case TriggerMode::kTime:
      return command.period;
    case TriggerMode::kTableAngle:
      return command.angle;
    case TriggerMode::kPathDistance:
      return command.distance;
    case TriggerMode::kBeltTravel:
      return command.travel;
    default:
      return 0;
  }
}

}  // namespace

Trigger::Trigger(const CellLayout& layout, const TriggerErrors& errors, std::uint64_t key)
    : layout_(layout), errors_(errors), key_(key), state_(layout) {}

bool Trigger::is_carried_out() const {
  const TriggerCommand& command = state_.command;
  const TriggerMode mode = commanded_mode(command);
  if (mode == TriggerMode::kTime) return microseconds(command.period) >= 1;
  if (mode == TriggerMode::kBeltTravel) {
    return command.travel != 0 && command.conveyor >= 1 &&
           static_cast<std::size_t>(command.conveyor) <= layout_.conveyors;
  }
  return !is_periodic(mode) || interval(command) > 0;
}

TriggerMode Trigger::mode() const {
  return is_carried_out() ? commanded_mode(state_.command) : TriggerMode::kOff;
}

void Trigger::command(const CellInputs& inputs, std::int64_t now_us, const MotionView& view) {
  const TriggerCommand before = state_.command;
  state_.command = inputs.trigger;
  state_.segment = inputs.segment;
  state_.exposure = inputs.exposure;
  const TriggerMode mode = this->mode();
  const bool gated =
      has_gate(mode) && static_cast<control::Mode>(inputs.motion.mode) == control::Mode::kProgram;
  const bool gate_changes = gated != state_.gated;
  state_.gated = gated;
  if (gate_changes || inputs.trigger.mode != before.mode || interval(inputs.trigger) != interval(before) ||
      (mode == TriggerMode::kBeltTravel && inputs.trigger.conveyor != before.conveyor)) {
    state_.gate = TriggerGate::kWaiting;
    state_.skipped = false;
    restart(now_us, view);
    if (is_periodic(mode) && !gated) fire(now_us);
  }
  if (mode != TriggerMode::kOff && inputs.trigger.request > before.request) {
    fire(now_us);
    if (is_periodic(mode)) {
      --state_.fired_since_entry;  // a requested exposure does not shift the periodic ones
    }
  }
}

/// Time from firing to the middle of an exposure that is triggered by position, s; else 0.
double Trigger::lead() const { return mode() == TriggerMode::kTime ? 0 : state_.exposure / 2; }

/// Reading of the belt in the middle of an exposure that fires at an instant.
BeltReading Trigger::belt(std::int64_t time_us, const MotionView& view) const {
  return view.belt_reading(static_cast<std::size_t>(state_.command.conveyor) - 1, time_us, lead());
}

double Trigger::path_clock(std::int64_t time_us, const MotionView& view) const {
  const control::ClockPoint point = view.running_segment(time_us).path_clock;
  return point.clock + lead() * point.rate;
}

bool Trigger::is_beyond_gate(std::int64_t time_us, const MotionView& view) const {
  return path_clock(time_us, view) > state_.command.to + kGateRounding;
}

/// Whether the gate is open in (from, to]. Where it opens there, the first exposure fires and `from` becomes
/// its instant.
bool Trigger::enter_gate(std::int64_t& from_us, std::int64_t to_us, const MotionView& view) {
  const std::int32_t run = view.running_segment(to_us).run;
  if (run != state_.run) state_.gate = TriggerGate::kWaiting;
  state_.run = run;
  if (run == 0 || state_.gate == TriggerGate::kPassed) return false;
  if (state_.gate == TriggerGate::kOpen) return true;
  const auto reached = [&](std::int64_t time_us) {
    return path_clock(time_us, view) >= state_.command.from - kIntervalTolerance;
  };
  if (!reached(to_us)) return false;
  if (!reached(from_us)) from_us = first_instant(from_us, to_us, reached);
  state_.gate = is_beyond_gate(from_us, view) ? TriggerGate::kPassed : TriggerGate::kOpen;
  if (state_.gate == TriggerGate::kPassed) return false;
  restart(from_us, view);
  fire(from_us);
  return true;
}

void Trigger::restart(std::int64_t now_us, const MotionView& view) {
  state_.entered_us = now_us;
  state_.fired_since_entry = 0;
  const control::Knot table = view.table(now_us);
  state_.entry_angle = table.position + lead() * table.velocity;
  const SensorOnSupport sensor = view.sensor_on_support(now_us);
  state_.path = -lead() * sensor.speed;
  state_.path_reference = {sensor.position.x(), sensor.position.y(), sensor.position.z()};
  if (mode() == TriggerMode::kBeltTravel) state_.entry_travel = belt(now_us, view).travel;
}

double Trigger::path_length(const Eigen::Vector3d& position) const {
  const Eigen::Map<const Eigen::Vector3d> reference(state_.path_reference.data());
  return state_.path + (position - reference).norm();
}

bool Trigger::is_due(std::int64_t time_us, const MotionView& view) const {
  const auto n = static_cast<double>(state_.fired_since_entry);
  switch (mode()) {
    case TriggerMode::kTime:
      return time_us >= state_.entered_us + microseconds(n * state_.command.period);
    case TriggerMode::kTableAngle: {
      const control::Knot table = view.table(time_us);
      return std::abs(table.position + lead() * table.velocity - state_.entry_angle) >=
             (n - kIntervalTolerance) * state_.command.angle;
    }
    case TriggerMode::kPathDistance: {
      const SensorOnSupport sensor = view.sensor_on_support(time_us);
      return path_length(sensor.position) + lead() * sensor.speed >=
             (n - kIntervalTolerance) * state_.command.distance;
    }
    case TriggerMode::kBeltTravel:
      return (belt(time_us, view).travel - state_.entry_travel) / state_.command.travel >=
             n - kIntervalTolerance;
    default:
      return false;
  }
}

void Trigger::advance(std::int64_t from_us, std::int64_t to_us, bool step_ends, const MotionView& view) {
  const bool open = fire_due(from_us, to_us, view);
  if (open && step_ends && mode() == TriggerMode::kPathDistance) {
    const Eigen::Vector3d position = view.sensor_on_support(to_us).position;
    state_.path = path_length(position);
    state_.path_reference = {position.x(), position.y(), position.z()};
  }
  latch(to_us, view);
}

/// Fires all exposures due in (from, to]. Returns false where a closed gate keeps a periodic mode from
/// firing.
bool Trigger::fire_due(std::int64_t from_us, std::int64_t to_us, const MotionView& view) {
  const bool gated = state_.gated;
  if (gated && !enter_gate(from_us, to_us, view)) return false;
  while (is_due(to_us, view)) {
    const std::int64_t due_us =
        first_instant(from_us, to_us, [&](std::int64_t time_us) { return is_due(time_us, view); });
    if (gated && is_beyond_gate(due_us, view)) break;
    if (is_full()) {
      skip_due(to_us, view);
      break;
    }
    fire(due_us);
  }
  if (gated && is_beyond_gate(to_us, view)) state_.gate = TriggerGate::kPassed;
  return true;
}

/// Instant of the light: delayed by latency and jitter, but not before the sensor fired.
std::int64_t Trigger::light_instant(std::int64_t fired_us, std::int64_t middle_us) const {
  double delay = errors_.latency;
  if (errors_.jitter > 0) delay += errors_.jitter * normal(key_ + static_cast<std::uint64_t>(state_.count));
  return std::max(fired_us, middle_us + microseconds(delay));
}

bool Trigger::is_full() const { return state_.pending.size() >= kMaxPending; }

control::ControllerError Trigger::error() const {
  if (!is_carried_out()) return control::ControllerError::kTriggerInterval;
  return state_.skipped ? control::ControllerError::kTriggerQueue : control::ControllerError::kNone;
}

/// Leaves out the periodic exposures that are due at or before an instant.
void Trigger::skip_due(std::int64_t time_us, const MotionView& view) {
  double travelled = 0;  // since the mode was entered, in the unit of the interval
  if (mode() == TriggerMode::kTime) {
    travelled = static_cast<double>(time_us - state_.entered_us) / kMicrosecondsPerSecond;
  } else if (mode() == TriggerMode::kTableAngle) {
    travelled = std::abs(view.table(time_us).position - state_.entry_angle);
  } else if (mode() == TriggerMode::kBeltTravel) {
    travelled = belt(time_us, view).travel - state_.entry_travel;
  } else {
    travelled = path_length(view.sensor_on_support(time_us).position);
  }
  state_.skipped = true;
  const double due = travelled / interval(state_.command);
  state_.fired_since_entry = static_cast<std::int64_t>(std::min(due, kMaxIntervals)) + 1;
}

void Trigger::fire(std::int64_t time_us) {
  state_.skipped = is_full();
  if (state_.skipped) return;
  ++state_.count;
  ++state_.fired_since_entry;
  PendingRecord pending{TriggerRecord(layout_)};
  pending.middle_us = time_us + microseconds(state_.exposure) / 2;
  pending.light_us = light_instant(time_us, pending.middle_us);
  pending.record.index = state_.count;
  pending.record.segment = state_.segment;
  pending.record.time = static_cast<double>(pending.middle_us) / kMicrosecondsPerSecond;
  pending.record.exposure = state_.exposure;
  state_.pending.push_back(pending);
  ++state_.incomplete;
}

/// Latches readings and true poses of all instants up to and including `to`.
void Trigger::latch(std::int64_t to_us, const MotionView& view) {
  if (state_.incomplete == 0) return;
  state_.incomplete = 0;
  for (PendingRecord& pending : state_.pending) {
    if (!pending.measured && pending.middle_us <= to_us) {
      pending.record.measured = view.measurement(pending.middle_us);
      for (std::size_t i = 0; i < layout_.conveyors; ++i) {
        pending.record.belts[i] = view.belt_reading(i, pending.middle_us, 0);
      }
      pending.measured = true;
    }
    if (!pending.illuminated && pending.light_us <= to_us) {
      view.write_truth(pending.light_us, pending.record.truth);
      pending.illuminated = true;
    }
    if (!is_complete(pending)) ++state_.incomplete;
  }
}

bool Trigger::publish(std::size_t max_records) {
  std::vector<TriggerRecord> records;
  while (records.size() < max_records && !state_.pending.empty() && is_complete(state_.pending.front())) {
    records.push_back(std::move(state_.pending.front().record));
    state_.pending.pop_front();
  }
  state_.newly_published = static_cast<std::int32_t>(records.size());
  if (records.empty()) return false;
  state_.current_record = records.back();
  if (max_records > 1) state_.published = std::move(records);
  return true;
}

std::int64_t Trigger::next_complete_us(std::int64_t from_us, std::int64_t to_us,
                                       const MotionView& view) const {
  if (!state_.pending.empty()) {
    return std::max(state_.pending.front().middle_us, state_.pending.front().light_us);
  }
  Trigger lookahead = *this;  // what happens later must not have happened yet
  lookahead.fire_due(from_us, to_us, view);
  if (lookahead.state_.pending.empty()) return std::numeric_limits<std::int64_t>::max();
  return lookahead.next_complete_us(from_us, to_us, view);
}

std::int32_t Trigger::queued() const {
  const auto incomplete = std::find_if_not(state_.pending.begin(), state_.pending.end(), is_complete);
  return static_cast<std::int32_t>(incomplete - state_.pending.begin());
}

}  // namespace robotcell
