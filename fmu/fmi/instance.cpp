#include "fmu/fmi/instance.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "fmu/control/time_units.h"
#include "fmu/fmi/resource_location.h"

namespace robotcell::fmi {
namespace {

constexpr double kHalfMicrosecond = 0.5 / kMicrosecondsPerSecond;
constexpr double kMaxTime = 1e9;  // s: a double resolves microseconds up to here
constexpr double kNever = std::numeric_limits<double>::infinity();

}  // namespace

Instance::Instance(std::string name, std::string resource_location, Log log, StepOptions options)
    : name_(std::move(name)),
      resource_location_(std::move(resource_location)),
      log_(std::move(log)),
      options_(std::move(options)),
      stop_time_(kNever),
      default_cell_(load_cell(description_path(CellParameters().cell_file))),
      loaded_(default_cell_),
      layout_(layout_of(default_cell_->description)),
      values_(layout_),
      table_(layout_, values_),
      token_(table_.token(false)) {
  start_unset_inputs(default_cell_->description);
}

void Instance::setup(double start_time, std::optional<double> stop_time) {
  if (phase_ != Phase::kInstantiated) reject_call("setting up the experiment", phase_);
  if (!(std::abs(start_time) < kMaxTime)) {
    throw std::invalid_argument("the start time must be finite and below 1e9 s, not " +
                                std::to_string(start_time));
  }
  if (stop_time && !(*stop_time >= start_time)) {
    throw std::invalid_argument("the stop time " + std::to_string(*stop_time) +
                                " s is before the start time " + std::to_string(start_time) + " s");
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
  cell();
  phase_ = options_.event_mode ? Phase::kEvent : Phase::kStepping;
}

void Instance::terminate() {
  if (phase_ != Phase::kStepping && phase_ != Phase::kEvent) reject_call("terminating", phase_);
  phase_ = Phase::kTerminated;
  log_.write(LogCategory::kEvent, "terminated at " + std::to_string(communication_time_) + " s");
}

void Instance::reset() {
  if (phase_ == Phase::kIntermediate) reject_call("resetting", phase_);
  phase_ = Phase::kInstantiated;
  start_time_ = communication_time_ = 0;
  stop_time_ = kNever;
  values_ = Values(layout_);
  home_inputs_set_ = {};
  start_unset_inputs(default_cell_->description);
  outputs_fresh_ = false;
  events_ = 0;
  logged_limit_ = 0;
  logged_refusal_.clear();
  cell_.reset();
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

void Instance::check_step(double current, double step) const {
  if (phase_ != Phase::kStepping) reject_call("a step", phase_);
  const double next = current + step;
  if (!(step > 0) || !(std::abs(next - start_time_) < kMaxTime)) {
    throw std::invalid_argument("the communication step size must be positive and finite, not " +
                                std::to_string(step));
  }
  if (!(std::abs(current - communication_time_) <= kHalfMicrosecond)) {
    throw std::invalid_argument("the communication point " + std::to_string(current) +
                                " s differs from the end of the last step, " +
                                std::to_string(communication_time_) + " s");
  }
  if (next > stop_time_ + kHalfMicrosecond) {
    throw std::invalid_argument("the step to " + std::to_string(next) + " s exceeds the stop time " +
                                std::to_string(stop_time_) + " s");
  }
}

/// Advances to the communication point current + step. The cell's clock follows the absolute time rounded to
/// microseconds, so rounding errors do not accumulate over steps.
StepResult Instance::do_step(double current, double step) {
  check_step(current, step);
  const std::int64_t planned = microseconds_to(current + step);
  const Events wanted = options_.event_mode && options_.early_return ? kAllEvents : 0;
  Cell& running = cell();
  const bool approximate_before = running.solver_fallbacks() > 0;
  const bool truncated_before = running.truncated_contacts() > 0;
  Cell::IntermediateUpdate intermediate;
  if (options_.intermediate) {
    intermediate = [this](std::int64_t now, std::int64_t end) { return intermediate_update(now, end); };
  }
  const Events happened = running.step(values_.inputs, start_time_, planned, wanted, intermediate);
  const std::int64_t reached = running.time_us();
  events_ = options_.event_mode ? happened : 0;
  if (reached < planned) {
    set_time(reached);
  } else {
    communication_time_ = current + step;
  }
  outputs_fresh_ = false;
  if (!approximate_before && running.solver_fallbacks() > 0) {
    log_.write(
        LogCategory::kWarning,
        "contact forces are approximate from " + std::to_string(communication_time_) +
            " s on: the contact solver did not converge; truth.contact.solver_fallbacks counts how often");
  }
  if (!truncated_before && running.truncated_contacts() > 0) {
    log_.write(LogCategory::kWarning,
               "a pair of bodies has more contact points from " + std::to_string(communication_time_) +
                   " s on than the collision detector finds; truth.contact.truncated counts how often");
  }
  log_refusal();
  if (log_.wants(LogCategory::kEvent)) log_step(happened, reached < planned);
  return {events_ != 0, reached < planned};
}

/// Logs once why the controller does not execute a command.
void Instance::log_refusal() {
  const std::string refusal = cell_->refusal();
  if (!refusal.empty() && refusal != logged_refusal_)
    log_.write(LogCategory::kWarning, "controller: " + refusal);
  logged_refusal_ = refusal;
}

void Instance::log_step(Events happened, bool early) {
  refresh_outputs();
  const CellOutputs& out = values_.outputs;
  if ((happened & kRecordPublished) != 0) {
    log_.write(LogCategory::kEvent, "record of exposure " + std::to_string(out.trigger.index) +
                                        " (middle at " + std::to_string(out.trigger.time) + " s)");
  }
  if ((happened & kCollisionChanged) != 0) {
    log_.write(LogCategory::kEvent, out.readings.collision.pairs == 0
                                        ? "no collision any more"
                                        : "body " + std::to_string(out.readings.collision.body_a) +
                                              " collides with body " +
                                              std::to_string(out.readings.collision.body_b));
  }
  if (out.controller.limit != logged_limit_) {
    logged_limit_ = out.controller.limit;
    log_.write(LogCategory::kEvent, out.controller.limit == 0
                                        ? "all axes are within their limits again"
                                        : "axis " + std::to_string(out.controller.limit) + " is at a limit");
  }
  if (early) {
    log_.write(LogCategory::kEvent,
               "early return from the step at " + std::to_string(communication_time_) + " s");
  }
}

/// Calls the importer within a step; returns the new end of the step.
std::int64_t Instance::intermediate_update(std::int64_t now, std::int64_t end) {
  set_time(now);
  phase_ = Phase::kIntermediate;
  const std::optional<double> wanted = options_.intermediate(communication_time_);
  if (phase_ != Phase::kIntermediate) throw std::logic_error("a call during the intermediate update failed");
  phase_ = Phase::kStepping;
  if (!wanted || !options_.early_return) return end;
  if (!std::isfinite(*wanted)) {
    throw std::invalid_argument("the time of the early return must be finite, not " +
                                std::to_string(*wanted));
  }
  return std::clamp(microseconds_to(std::min(*wanted, communication_time_ + kMaxTime)), now, end);
}

void Instance::set_time(std::int64_t ticks) {
  communication_time_ = start_time_ + static_cast<double>(ticks) / kMicrosecondsPerSecond;
  outputs_fresh_ = false;
}

std::shared_ptr<const LoadedCell> load_cell(const std::string& path,
                                            const std::shared_ptr<const LoadedCell>& known) {
  const std::string json = read_text_file(path);
  const std::uint64_t hash = hash_of(reinterpret_cast<const std::uint8_t*>(json.data()), json.size());
  if (known && known->path == path && known->hash == hash) return known;
  try {
    CellDescription description = parse_cell(json);
    proximity::BodySet bodies(std::move(description.sensing.meshes), known ? &known->bodies : nullptr);
    return std::make_shared<const LoadedCell>(
        LoadedCell{path, hash, std::move(description), std::move(bodies)});
  } catch (const DescriptionError& error) {
    throw DescriptionError(path + ": " + error.what());
  }
}

std::string Instance::description_path(const std::string& file) const {
  if (file.empty()) {
    throw std::invalid_argument("cell.file is empty: expected the path of a cell description");
  }
  if (is_absolute(file)) return file;
  return resource_folder(resource_location_) + "/" + file;
}

void Instance::start_unset_inputs(const CellDescription& cell) {
  CellInputs start = start_inputs(cell);
  const auto from = home_inputs(start);
  const auto to = home_inputs(values_.inputs);
  for (std::size_t i = 0; i < kHomeInputs; ++i) {
    if (!home_inputs_set_[i]) *to[i] = *from[i];
  }
}

Cell& Instance::cell() {
  if (cell_) return *cell_;
  const std::string path = description_path(values_.parameters.cell_file);
  loaded_ = path == default_cell_->path ? default_cell_ : load_cell(path, loaded_);
  const CellDescription& description = loaded_->description;
  const std::string other = difference(layout_of(description), layout_);
  if (!other.empty()) {
    throw DescriptionError(path + ": its devices do not match the variables of this FMU: " + other);
  }
  try {
    cell_ = std::make_unique<Cell>(description, loaded_->bodies, values_.parameters,
                                   resource_folder(resource_location_));
  } catch (const DescriptionError& error) {
    throw DescriptionError(path + ": " + error.what());
  }
  start_unset_inputs(description);
  log_.write(LogCategory::kEvent, "cell loaded from " + path);
  const std::string warning = soft_part_warning(description.parts);
  if (!warning.empty()) log_.write(LogCategory::kWarning, warning);
  if (!cell_->intersecting_bodies().empty()) {
    log_.write(LogCategory::kWarning,
               "contact shapes that intersect at the start do not touch: " + cell_->intersecting_bodies());
  }
  return *cell_;
}

Snapshot Instance::snapshot() const {
  if (phase_ == Phase::kIntermediate) reject_call("getting the state", phase_);
  Snapshot snapshot(layout_);
  snapshot.phase = phase_;
  snapshot.start_time = start_time_;
  snapshot.stop_time = stop_time_;
  snapshot.communication_time = communication_time_;
  snapshot.events = events_;
  snapshot.parameters = values_.parameters;
  snapshot.inputs = values_.inputs;
  snapshot.home_inputs_set = home_inputs_set_;
  snapshot.description_hash = cell_ ? loaded_->hash : 0;
  if (cell_) snapshot.cell = cell_->state();
  return snapshot;
}

void Instance::restore(const Snapshot& snapshot) {
  if (phase_ == Phase::kIntermediate) reject_call("setting the state", phase_);
  if (snapshot.phase == Phase::kEvent && !options_.event_mode) {
    throw std::invalid_argument("the state was taken in event mode, which this instance does not use");
  }
  const CellParameters before = values_.parameters;
  values_.parameters = snapshot.parameters;
  values_.inputs = snapshot.inputs;
  check_bounds();
  home_inputs_set_ = snapshot.home_inputs_set;
  outputs_fresh_ = false;
  if (!snapshot.cell || !same_parameters(before, snapshot.parameters)) cell_.reset();
  if (snapshot.cell) {
    const double elapsed = snapshot.communication_time - snapshot.start_time;
    if (std::llround(elapsed * kMicrosecondsPerSecond) != snapshot.cell->time_us) {
      throw std::invalid_argument(
          "the times of the state are inconsistent: communication time and cell time differ");
    }
    cell();
    if (loaded_->hash != snapshot.description_hash) {
      throw std::invalid_argument("the state belongs to another cell description than " + loaded_->path);
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
