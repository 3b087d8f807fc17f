#include "fmu/fmi/instance.h"

#include <cmath>
#include <limits>
#include <stdexcept>

#include "fmu/fmi/resource_location.h"

namespace robotcell::fmi {
namespace {

constexpr double kTicksPerSecond = 1e6;
constexpr double kLongestTime = 1e9;  // s: below it a double still tells microseconds apart
constexpr double kNever = std::numeric_limits<double>::infinity();

const char* phase_name(Phase phase) {
  switch (phase) {
    case Phase::kInstantiated:
      return "before initialization";
    case Phase::kInitialization:
      return "in initialization mode";
    case Phase::kStepping:
      return "while stepping";
    case Phase::kTerminated:
      return "after terminate";
    default:
      return "after an error";
  }
}

[[noreturn]] void refuse(const std::string& what, Phase phase) {
  throw std::logic_error(what + " is not allowed " + phase_name(phase));
}

bool same_parameters(const CellParameters& a, const CellParameters& b) {
  const auto same_row = [](const DhDeviation& x, const DhDeviation& y) {
    return x.a == y.a && x.d == y.d && x.alpha == y.alpha && x.theta == y.theta && x.beta == y.beta;
  };
  bool same = a.cell_file == b.cell_file && a.seed == b.seed && a.as_built.tool == b.as_built.tool &&
              a.as_built.table == b.as_built.table && a.as_built.platter == b.as_built.platter &&
              a.as_built.trigger_latency == b.as_built.trigger_latency;
  for (std::size_t i = 0; i < kJoints; ++i) same = same && same_row(a.as_built.dh[i], b.as_built.dh[i]);
  return same;
}

}  // namespace

Instance::Instance(std::string name, std::string resource_location, Logger logger)
    : name_(std::move(name)),
      resource_location_(std::move(resource_location)),
      logger_(std::move(logger)),
      stop_time_(kNever) {}

void Instance::log(const std::string& message) const {
  if (logger_) logger_(message);
}

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
  phase_ = Phase::kStepping;
}

void Instance::terminate() {
  if (phase_ != Phase::kStepping) refuse("terminating", phase_);
  phase_ = Phase::kTerminated;
}

void Instance::reset() {
  phase_ = Phase::kInstantiated;
  start_time_ = communication_time_ = 0;
  stop_time_ = kNever;
  values_ = Values();
  outputs_fresh_ = false;
  cell_.reset();
}

void Instance::require_stepping(const char* what) const {
  if (phase_ != Phase::kStepping) refuse(what, phase_);
}

std::int64_t Instance::ticks_to(double time) const {
  return std::llround((time - start_time_) * kTicksPerSecond);
}

/// Goes to the communication point current + step. The cell's clock follows the absolute time, rounded to
/// microseconds: parts of a microsecond are carried from step to step and never add up.
void Instance::do_step(double current, double step) {
  require_stepping("a step");
  const double next = current + step;
  if (!(step > 0) || !(std::abs(next - start_time_) < kLongestTime)) {
    throw std::invalid_argument("the communication step size must be positive and finite");
  }
  const double tolerance = 0.5 / kTicksPerSecond;
  if (!(std::abs(current - communication_time_) <= tolerance)) {
    throw std::invalid_argument("the communication point " + std::to_string(current) +
                                " s is not where the last step ended, " +
                                std::to_string(communication_time_) + " s");
  }
  if (next > stop_time_ + tolerance) throw std::invalid_argument("the step goes beyond the stop time");
  cell().advance(values_.inputs, ticks_to(next));
  communication_time_ = next;
  outputs_fresh_ = false;
}

const Variable& Instance::variable(std::uint32_t reference, Type type) const {
  if (reference >= variables().size()) {
    throw std::invalid_argument("there is no variable with value reference " + std::to_string(reference));
  }
  const Variable& found = variables()[reference];
  if (found.type != type) throw std::invalid_argument(found.name + " is of another type");
  return found;
}

template <class T>
T& Instance::get(std::uint32_t reference) {
  const Variable& found = variable(reference, type_of<T>());
  if (!outputs_fresh_ &&
      (found.causality == Causality::kOutput || found.causality == Causality::kIndependent)) {
    refresh_outputs();
  }
  return member<T>(values_, found);
}

void Instance::check_settable(const Variable& variable) const {
  const bool early = phase_ == Phase::kInstantiated || phase_ == Phase::kInitialization;
  const bool input = variable.causality == Causality::kInput;
  if (!input && variable.causality != Causality::kParameter) {
    throw std::invalid_argument(variable.name + " is neither an input nor a parameter");
  }
  if (!early && !(input && phase_ == Phase::kStepping)) refuse("setting " + variable.name, phase_);
}

template <class T>
void Instance::set(std::uint32_t reference, const T& value) {
  const Variable& found = variable(reference, type_of<T>());
  check_settable(found);
  if constexpr (std::is_same_v<T, double>) {
    if (!std::isfinite(value)) throw std::invalid_argument(found.name + " must be a finite number");
  }
  if constexpr (std::is_same_v<T, std::int32_t>) {
    if (found.max > found.min && (value < found.min || value > found.max)) {
      throw std::invalid_argument(found.name + " must be from " + std::to_string(found.min) + " to " +
                                  std::to_string(found.max) + ", not " + std::to_string(value));
    }
  }
  member<T>(values_, found) = value;
  if (found.causality == Causality::kParameter) {
    cell_.reset();
    outputs_fresh_ = false;
  }
}

template double& Instance::get(std::uint32_t);
template std::int32_t& Instance::get(std::uint32_t);
template bool& Instance::get(std::uint32_t);
template std::string& Instance::get(std::uint32_t);
template void Instance::set(std::uint32_t, const double&);
template void Instance::set(std::uint32_t, const std::int32_t&);
template void Instance::set(std::uint32_t, const bool&);
template void Instance::set(std::uint32_t, const std::string&);

void Instance::refresh_outputs() {
  if (phase_ == Phase::kInstantiated) refuse("getting an output", phase_);
  values_.outputs = cell().outputs();
  if (values_.outputs.trigger.index > 0) values_.outputs.trigger.time += start_time_;
  values_.time = communication_time_;
  outputs_fresh_ = true;
}

std::string Instance::description_path() const {
  const std::string& file = values_.parameters.cell_file;
  if (!file.empty() && file.front() == '/') return file;
  if (file.empty()) throw std::invalid_argument("cell.file must name a file");
  return resource_folder(resource_location_) + "/" + file;
}

Cell& Instance::cell() {
  if (cell_) return *cell_;
  const std::string path = description_path();
  const std::string json = read_text_file(path);
  try {
    cell_ = std::make_unique<Cell>(parse_cell(json), values_.parameters);
  } catch (const DescriptionError& error) {
    throw DescriptionError(path + ": " + error.what());
  }
  description_hash_ = hash_of(reinterpret_cast<const std::uint8_t*>(json.data()), json.size());
  return *cell_;
}

Snapshot Instance::snapshot() const {
  Snapshot snapshot{phase_,
                    start_time_,
                    stop_time_,
                    communication_time_,
                    values_.parameters,
                    values_.inputs,
                    cell_ ? description_hash_ : 0,
                    {}};
  if (cell_) snapshot.cell = cell_->state();
  return snapshot;
}

void Instance::restore(const Snapshot& snapshot) {
  const CellParameters before = values_.parameters;
  values_.parameters = snapshot.parameters;
  values_.inputs = snapshot.inputs;
  outputs_fresh_ = false;
  if (!snapshot.cell || !same_parameters(before, snapshot.parameters)) cell_.reset();
  if (snapshot.cell) {
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
}

}  // namespace robotcell::fmi
