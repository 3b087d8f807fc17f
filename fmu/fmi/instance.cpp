#include "fmu/fmi/instance.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "fmu/control/time_units.h"
#include "fmu/fmi/number_text.h"

namespace robotcell::fmi {
namespace {

constexpr double kHalfMicrosecond = 0.5 / kMicrosecondsPerSecond;
constexpr double kNever = std::numeric_limits<double>::infinity();
/// A single-precision number is that close to a time, relative to it, even after a sum.
constexpr double kSinglePrecision = 1.0 / (1 << 23);
constexpr double kMaxRelativeGap = 0.1;

/// Largest difference (s) of a communication point from the end of the last step: half a microsecond, or what
/// single precision makes of the time, where that still resolves the step. The clock follows absolute times,
/// so that differences do not accumulate.
double time_tolerance(double time, double step) {
  const double single = kSinglePrecision * std::abs(time);
  return single <= kMaxRelativeGap * step ? std::max(kHalfMicrosecond, single) : kHalfMicrosecond;
}

}  // namespace

Instance::Instance(std::string name, Log log, StepOptions options)
    : log_(std::move(log)),
      options_(std::move(options)),
      name_(std::move(name)),
      stop_time_(kNever),
      table_(std::vector<Variable>()) {}

void Instance::set_table(VariableTable table) {
  table_ = std::move(table);
  if (token_.empty()) token_ = table_.token(false);
}

void Instance::fail() {
  intermediate_failed_ = true;
  if (phase_ != Phase::kIntermediate) phase_ = Phase::kFailed;
}

void Instance::setup(double start_time, std::optional<double> stop_time) {
  if (phase_ != Phase::kInstantiated) reject_call("setting up the experiment", phase_);
  if (!(std::abs(start_time) < kMaxTime)) {
    throw std::invalid_argument("the start time must be finite and within " + seconds(kMaxTime) + ", not " +
                                seconds(start_time));
  }
  if (stop_time && !(*stop_time >= start_time)) {
    throw std::invalid_argument("the stop time " + seconds(*stop_time) + " is before the start time " +
                                seconds(start_time));
  }
  start_time_ = communication_time_ = start_time;
  stop_time_ = stop_time.value_or(kNever);
}

void Instance::enter_initialization() {
  if (phase_ != Phase::kInstantiated) reject_call("entering initialization mode", phase_);
  phase_ = Phase::kInitialization;
}

void Instance::exit_initialization() {
  if (phase_ != Phase::kInitialization) reject_call("leaving initialization mode", phase_);
  start();
  phase_ = options_.event_mode ? Phase::kEvent : Phase::kStepping;
}

void Instance::terminate() {
  if (phase_ != Phase::kStepping && phase_ != Phase::kEvent) reject_call("terminating", phase_);
  phase_ = Phase::kTerminated;
  log_.write(LogCategory::kEvent, "terminated at " + seconds(communication_time_));
}

void Instance::reset() {
  if (phase_ == Phase::kIntermediate) reject_call("resetting", phase_);
  phase_ = Phase::kInstantiated;
  start_time_ = communication_time_ = 0;
  stop_time_ = kNever;
  events_ = 0;
  clear();
}

void Instance::enter_event_mode() {
  if (!options_.event_mode) throw std::logic_error("the instance was created without event mode");
  if (phase_ != Phase::kStepping) reject_call("entering event mode", phase_);
  phase_ = Phase::kEvent;
}

void Instance::enter_step_mode() {
  if (phase_ != Phase::kEvent) reject_call("entering step mode", phase_);
  events_ = 0;
  phase_ = Phase::kStepping;
}

void Instance::require_event() const {
  if (phase_ != Phase::kEvent) reject_call("evaluating discrete states", phase_);
}

/// No iteration is needed: inputs set in an event act in the next step. Clocks are reset.
void Instance::update_discrete_states() {
  if (phase_ != Phase::kEvent) reject_call("updating discrete states", phase_);
  events_ = 0;
}

bool Instance::record_clock() const {
  if (phase_ != Phase::kEvent && phase_ != Phase::kInitialization) reject_call("reading a clock", phase_);
  return (events_ & kRecordPublished) != 0;
}

std::int64_t Instance::microseconds_to(double time) const {
  return std::llround((time - start_time_) * kMicrosecondsPerSecond);
}

/// The clock follows the absolute time rounded to microseconds, so rounding errors do not accumulate over
/// steps.
std::int64_t Instance::begin_step(double current, double step) const {
  if (phase_ != Phase::kStepping) reject_call("a step", phase_);
  const double next = current + step;
  if (!(step > 0) || !(std::abs(next) < kMaxTime)) {
    throw std::invalid_argument("the communication step size must be positive and finite, and end within " +
                                seconds(kMaxTime) + ", not " + seconds(step));
  }
  const double tolerance = time_tolerance(current, step), gap = current - communication_time_;
  if (!(std::abs(gap) <= tolerance)) {
    throw std::invalid_argument("the communication point " + seconds(current) +
                                " differs from the end of the last step, " + seconds(communication_time_) +
                                ", by " + seconds(gap) + "; the tolerance is " + seconds(tolerance));
  }
  if (next > stop_time_ + tolerance) {
    throw std::invalid_argument("the step to " + seconds(next) + " exceeds the stop time " +
                                seconds(stop_time_) + " by " + seconds(next - stop_time_) +
                                "; the tolerance is " + seconds(tolerance));
  }
  return microseconds_to(next);
}

bool Instance::end_step(double current, double step, std::int64_t reached) {
  const std::int64_t planned = microseconds_to(current + step);
  if (reached != planned) {
    set_time(reached);
  } else {
    communication_time_ = current + step;
  }
  return reached < planned;
}

std::int64_t Instance::intermediate_update(std::int64_t now, std::int64_t end) {
  set_time(now);
  phase_ = Phase::kIntermediate;
  intermediate_failed_ = false;
  const std::optional<double> wanted = options_.intermediate(communication_time_);
  phase_ = Phase::kStepping;
  if (intermediate_failed_) throw std::logic_error("a call during the intermediate update failed");
  if (!wanted || !options_.early_return) return end;
  if (!std::isfinite(*wanted)) {
    throw std::invalid_argument("the time of the early return must be finite, not " + number_text(*wanted));
  }
  return std::clamp(microseconds_to(std::clamp(*wanted, -kMaxTime, kMaxTime)), now, end);
}

void Instance::set_time(std::int64_t ticks) {
  communication_time_ = start_time_ + static_cast<double>(ticks) / kMicrosecondsPerSecond;
}

SavedPhase Instance::saved_phase() const {
  if (phase_ == Phase::kIntermediate) reject_call("getting the state", phase_);
  return {phase_, start_time_, stop_time_, communication_time_};
}

void Instance::check_restorable(Phase saved) const {
  if (phase_ == Phase::kIntermediate) reject_call("setting the state", phase_);
  if (saved == Phase::kEvent && !options_.event_mode) {
    throw std::invalid_argument("the state was taken in event mode, which this instance does not use");
  }
}

void Instance::restore_phase(const SavedPhase& saved) {
  phase_ = saved.phase;
  start_time_ = saved.start_time;
  stop_time_ = saved.stop_time;
  communication_time_ = saved.communication_time;
}

}  // namespace robotcell::fmi
