#include "fmu/fmi/instance.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "fmu/fmi/resource_location.h"

namespace robotcell::fmi {
namespace {

constexpr double kTicksPerSecond = 1e6;
constexpr double kHalfTick = 0.5 / kTicksPerSecond;
constexpr double kLongestTime = 1e9;  // s: below it a double still tells microseconds apart
constexpr double kNever = std::numeric_limits<double>::infinity();

}  // namespace

Instance::Instance(std::string name, std::string resource_location, Log log, StepOptions options)
    : name_(std::move(name)),
      resource_location_(std::move(resource_location)),
      log_(std::move(log)),
      options_(std::move(options)),
      stop_time_(kNever),
      own_(load_cell(description_path(CellParameters().cell_file))),
      layout_(layout_of(own_.description)),
      values_(layout_),
      table_(layout_, values_),
      token_(table_.token(false)) {}

void Instance::setup(double start_time, std::optional<double> stop_time) {
  if (phase_ != Phase::kInstantiated) refuse("setting up the experiment", phase_);
  if (!(std::abs(start_time) < kLongestTime)) throw std::invalid_argument("the start time must be finite");
  if (stop_time && !(*stop_time >= start_time)) {
    throw std::invalid_argument("the stop time must not lie before the start time");
  }
  start_time_ = communication_time_ = start_time;
  stop_time_ = stop_time.value_or(kNever);
}

void Instance::enter_initialization() {
  if (phase_ != Phase::kInstantiated) refuse("entering initialization mode", phase_);
  phase_ = Phase::kInitialization;
}

void Instance::exit_initialization() {
  if (phase_ != Phase::kInitialization) refuse("leaving initialization mode", phase_);
  cell();
  phase_ = options_.event_mode ? Phase::kEvent : Phase::kStepping;
}

void Instance::terminate() {
  if (phase_ != Phase::kStepping && phase_ != Phase::kEvent) refuse("terminating", phase_);
  phase_ = Phase::kTerminated;
  log_.write(LogCategory::kEvent, "terminated at " + std::to_string(communication_time_) + " s");
}

void Instance::reset() {
  if (phase_ == Phase::kIntermediate) refuse("resetting", phase_);
  phase_ = Phase::kInstantiated;
  start_time_ = communication_time_ = 0;
  stop_time_ = kNever;
  values_ = Values(layout_);
  outputs_fresh_ = false;
  events_ = 0;
  logged_limit_ = 0;
  cell_.reset();
}

void Instance::enter_event_mode() {
  if (!options_.event_mode) throw std::logic_error("the instance was made without event mode");
  if (phase_ != Phase::kStepping) refuse("entering event mode", phase_);
  phase_ = Phase::kEvent;
}

void Instance::enter_step_mode() {
  if (phase_ != Phase::kEvent) refuse("entering step mode", phase_);
  events_ = 0;
  phase_ = Phase::kStepping;
}

void Instance::require_event() const {
  if (phase_ != Phase::kEvent) refuse("evaluating discrete states", phase_);
}

/// Nothing to iterate over: what is set in an event acts in the step that follows. Clocks are done.
void Instance::update_discrete_states() {
  if (phase_ != Phase::kEvent) refuse("updating discrete states", phase_);
  events_ = 0;
}

bool Instance::record_clock() const {
  if (phase_ != Phase::kEvent && phase_ != Phase::kInitialization) refuse("reading a clock", phase_);
  return (events_ & kRecordShown) != 0;
}

std::int64_t Instance::ticks_to(double time) const {
  return std::llround((time - start_time_) * kTicksPerSecond);
}

void Instance::check_step(double current, double step) const {
  if (phase_ != Phase::kStepping) refuse("a step", phase_);
  const double next = current + step;
  if (!(step > 0) || !(std::abs(next - start_time_) < kLongestTime)) {
    throw std::invalid_argument("the communication step size must be positive and finite");
  }
  if (!(std::abs(current - communication_time_) <= kHalfTick)) {
    throw std::invalid_argument("the communication point " + std::to_string(current) +
                                " s is not where the last step ended, " +
                                std::to_string(communication_time_) + " s");
  }
  if (next > stop_time_ + kHalfTick) throw std::invalid_argument("the step goes beyond the stop time");
}

/// Goes to the communication point current + step. The cell's clock follows the absolute time, rounded to
/// microseconds: parts of a microsecond are carried from step to step and never add up.
StepResult Instance::do_step(double current, double step) {
  check_step(current, step);
  const std::int64_t planned = ticks_to(current + step);
  std::int64_t end = planned;
  const Events wanted = options_.event_mode && options_.early_return ? kAllEvents : 0;
  Cell& running = cell();
  running.begin_step(values_.inputs);
  std::int64_t reached = running.time_us();
  while (reached < end) {
    const std::int64_t stop = next_stop(end);
    reached = running.run(values_.inputs, stop, wanted);
    if (reached < stop) break;  // at an event
    if (reached < end) end = ask_importer(reached, end);
  }
  const Events happened = running.end_step();
  events_ = options_.event_mode ? happened : 0;
  if (reached < planned) {
    now_at(reached);
  } else {
    communication_time_ = current + step;
  }
  outputs_fresh_ = false;
  if (log_.wants(LogCategory::kEvent)) log_step(happened, reached < planned);
  return {events_ != 0, reached < planned};
}

void Instance::log_step(Events happened, bool early) {
  refresh_outputs();
  const CellOutputs& out = values_.outputs;
  if ((happened & kRecordShown) != 0) {
    log_.write(LogCategory::kEvent, "exposure " + std::to_string(out.trigger.index) +
                                        ", whose middle was at " + std::to_string(out.trigger.time) +
                                        " s, is on display");
  }
  if ((happened & kCollisionChanged) != 0) {
    log_.write(LogCategory::kEvent, out.collision.pairs == 0
                                        ? "nothing collides any more"
                                        : "body " + std::to_string(out.collision.body_a) +
                                              " collides with body " + std::to_string(out.collision.body_b));
  }
  if (out.controller.limit != logged_limit_) {
    logged_limit_ = out.controller.limit;
    log_.write(LogCategory::kEvent,
               out.controller.limit == 0
                   ? "no limit is in the way of a set-point any more"
                   : "a limit keeps axis " + std::to_string(out.controller.limit) + " from its set-point");
  }
  if (early) {
    log_.write(LogCategory::kEvent, "the step ends early, at " + std::to_string(communication_time_) + " s");
  }
}

/// The next instant of the controller's cycle where the importer wants to be called, else the end.
std::int64_t Instance::next_stop(std::int64_t end) const {
  if (!options_.intermediate) return end;
  const std::int64_t cycle = cell_->controller_cycle_us();
  return std::min(end, (cell_->time_us() / cycle + 1) * cycle);
}

/// Lets the importer look at the outputs inside a step; returns where the step ends from now on.
std::int64_t Instance::ask_importer(std::int64_t now, std::int64_t end) {
  now_at(now);
  phase_ = Phase::kIntermediate;
  const std::optional<double> wanted = options_.intermediate(communication_time_);
  if (phase_ != Phase::kIntermediate) throw std::logic_error("a call inside the intermediate update failed");
  phase_ = Phase::kStepping;
  if (!wanted || !options_.early_return) return end;
  if (!std::isfinite(*wanted)) throw std::invalid_argument("the time of the early return must be finite");
  return std::clamp(ticks_to(std::min(*wanted, communication_time_ + kLongestTime)), now, end);
}

void Instance::now_at(std::int64_t ticks) {
  communication_time_ = start_time_ + static_cast<double>(ticks) / kTicksPerSecond;
  outputs_fresh_ = false;
}

LoadedCell load_cell(const std::string& path) {
  const std::string json = read_text_file(path);
  try {
    return {path, hash_of(reinterpret_cast<const std::uint8_t*>(json.data()), json.size()), parse_cell(json)};
  } catch (const DescriptionError& error) {
    throw DescriptionError(path + ": " + error.what());
  }
}

std::string Instance::description_path(const std::string& file) const {
  if (!file.empty() && file.front() == '/') return file;
  if (file.empty()) throw std::invalid_argument("cell.file must name a file");
  return resource_folder(resource_location_) + "/" + file;
}

Cell& Instance::cell() {
  if (cell_) return *cell_;
  const std::string path = description_path(values_.parameters.cell_file);
  const LoadedCell loaded = path == own_.path ? own_ : load_cell(path);
  const std::string other = difference(layout_of(loaded.description), layout_);
  if (!other.empty()) {
    throw DescriptionError(path + ": its layout is not that of this FMU's variables: " + other);
  }
  try {
    cell_ = std::make_unique<Cell>(loaded.description, values_.parameters);
  } catch (const DescriptionError& error) {
    throw DescriptionError(path + ": " + error.what());
  }
  description_hash_ = loaded.hash;
  log_.write(LogCategory::kEvent, "the cell is made from " + path);
  const std::string cost = cost_of_soft_parts(loaded.description.parts);
  if (!cost.empty()) log_.write(LogCategory::kWarning, cost);
  return *cell_;
}

Snapshot Instance::snapshot() const {
  if (phase_ == Phase::kIntermediate) refuse("getting the state", phase_);
  Snapshot snapshot(layout_);
  snapshot.phase = phase_;
  snapshot.start_time = start_time_;
  snapshot.stop_time = stop_time_;
  snapshot.communication_time = communication_time_;
  snapshot.events = events_;
  snapshot.parameters = values_.parameters;
  snapshot.inputs = values_.inputs;
  snapshot.description_hash = cell_ ? description_hash_ : 0;
  if (cell_) snapshot.cell = cell_->state();
  return snapshot;
}

void Instance::restore(const Snapshot& snapshot) {
  if (phase_ == Phase::kIntermediate) refuse("setting the state", phase_);
  if (snapshot.phase == Phase::kEvent && !options_.event_mode) {
    throw std::invalid_argument("the state is from event mode, which this instance does not use");
  }
  const CellParameters before = values_.parameters;
  values_.parameters = snapshot.parameters;
  values_.inputs = snapshot.inputs;
  outputs_fresh_ = false;
  if (!snapshot.cell || !same_parameters(before, snapshot.parameters)) cell_.reset();
  if (snapshot.cell) {
    const double elapsed = snapshot.communication_time - snapshot.start_time;
    if (std::llround(elapsed * kTicksPerSecond) != snapshot.cell->time_us) {
      throw std::invalid_argument("the state's times contradict each other");
    }
    cell();
    if (description_hash_ != snapshot.description_hash) {
      throw std::invalid_argument("the state belongs to another description of the cell");
    }
    cell_->restore(*snapshot.cell);
  }
  phase_ = snapshot.phase;
  start_time_ = snapshot.start_time;
  stop_time_ = snapshot.stop_time;
  communication_time_ = snapshot.communication_time;
  events_ = snapshot.events;
}

}  // namespace robotcell::fmi
