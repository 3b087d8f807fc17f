#include "fmu/fmi/cell_instance.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>

#include "fmu/control/time_units.h"
#include "fmu/fmi/number_text.h"
#include "fmu/fmi/resource_location.h"
#include "fmu/fmi/sealed_state.h"

namespace robotcell::fmi {

CellInstance::CellInstance(const std::string& name, std::string resource_location, const Log& log,
                           const StepOptions& options)
    : Instance(name, log, options),
      resource_location_(std::move(resource_location)),
      default_cell_(load_cell(description_path(CellParameters().cell_file))),
      loaded_(default_cell_),
      layout_(layout_of(default_cell_->description)),
      values_(layout_) {
  set_table(VariableTable(layout_, values_));
  start_unset_inputs(default_cell_->description);
}

std::unique_ptr<Instance> make_instance(const std::string& name, const std::string& resource_location,
                                        const Log& log, const StepOptions& options) {
  return std::make_unique<CellInstance>(name, resource_location, log, options);
}

bool CellInstance::use_variant(const std::string& token, int version) {
  if (Instance::use_variant(token, version)) return true;
  for (const TableOptions& options : table_options(version)) {
    set_table(VariableTable(layout_, values_, options));
    if (Instance::use_variant(token, version)) return true;
  }
  return false;
}

void CellInstance::clear() {
  values_ = Values(layout_);
  home_inputs_set_ = {};
  start_unset_inputs(default_cell_->description);
  outputs_fresh_ = false;
  logged_limit_ = 0;
  logged_refusal_.clear();
  cell_.reset();
}

/// Advances to the communication point current + step.
StepResult CellInstance::do_step(double current, double step) {
  const std::int64_t planned = begin_step(current, step);
  const Events wanted = options_.event_mode && options_.early_return ? kAllEvents : 0;
  Cell& running = cell();
  const bool approximate_before = running.solver_fallbacks() > 0;
  const bool truncated_before = running.truncated_contacts() > 0;
  Cell::IntermediateUpdate intermediate;
  if (options_.intermediate) {
    intermediate = [this](std::int64_t now, std::int64_t end) {
      outputs_fresh_ = false;
      return intermediate_update(now, end);
    };
  }
  outputs_fresh_ = false;
  const std::size_t records = table().records().empty() ? 1 : kMaxRecords;
  const Events happened = running.step(values_.inputs, start_time_, planned, wanted, intermediate, records);
  events_ = options_.event_mode ? happened : 0;
  const bool early = end_step(current, step, running.time_us());
  outputs_fresh_ = false;
  if (!approximate_before && running.solver_fallbacks() > 0) {
    log_.write(
        LogCategory::kWarning,
        "contact forces are approximate from " + seconds(communication_time_) +
            " on: the contact solver did not converge; truth.contact.solver_fallbacks counts how often");
  }
  if (!truncated_before && running.truncated_contacts() > 0) {
    log_.write(LogCategory::kWarning,
               "a pair of bodies has more contact points from " + seconds(communication_time_) +
                   " on than the collision detector finds; truth.contact.truncated counts how often");
  }
  log_refusal();
  if (log_.wants(LogCategory::kEvent)) log_step(happened, early);
  return {events_ != 0, early};
}

/// Logs once why the controller does not execute a command.
void CellInstance::log_refusal() {
  const std::string refusal = cell_->refusal();
  if (!refusal.empty() && refusal != logged_refusal_)
    log_.write(LogCategory::kWarning, "controller: " + refusal);
  logged_refusal_ = refusal;
}

void CellInstance::log_step(Events happened, bool early) {
  refresh_outputs();
  const CellOutputs& out = values_.outputs;
  if ((happened & kRecordPublished) != 0) {
    log_.write(LogCategory::kEvent, "record of exposure " + std::to_string(out.trigger.index) +
                                        " (middle at " + seconds(out.trigger.time) + ")");
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
    log_.write(LogCategory::kEvent, "early return from the step at " + seconds(communication_time_));
  }
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

std::string CellInstance::description_path(const std::string& file) const {
  if (file.empty()) {
    throw std::invalid_argument("cell.file is empty: expected the path of a cell description");
  }
  if (is_absolute(file)) return file;
  return resource_folder(resource_location_) + "/" + file;
}

void CellInstance::start_unset_inputs(const CellDescription& cell) {
  CellInputs start = start_inputs(cell);
  const auto from = home_inputs(start);
  const auto to = home_inputs(values_.inputs);
  for (std::size_t i = 0; i < kHomeInputs; ++i) {
    if (!home_inputs_set_[i]) *to[i] = *from[i];
  }
}

Cell& CellInstance::cell() {
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

std::unique_ptr<SavedState> CellInstance::snapshot() const {
  const SavedPhase saved = saved_phase();
  auto snapshot = std::make_unique<Snapshot>(layout_);
  snapshot->phase = saved.phase;
  snapshot->start_time = saved.start_time;
  snapshot->stop_time = saved.stop_time;
  snapshot->communication_time = saved.communication_time;
  snapshot->events = events_;
  snapshot->parameters = values_.parameters;
  snapshot->inputs = values_.inputs;
  snapshot->home_inputs_set = home_inputs_set_;
  snapshot->description_hash = cell_ ? loaded_->hash : 0;
  if (cell_) snapshot->cell = cell_->state();
  return snapshot;
}

void CellInstance::restore(const SavedState& state) {
  const auto& snapshot = dynamic_cast<const Snapshot&>(state);
  check_restorable(snapshot.phase);
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
  restore_phase({snapshot.phase, snapshot.start_time, snapshot.stop_time, snapshot.communication_time});
  events_ = snapshot.events;
}

std::vector<std::uint8_t> CellInstance::serialize(const SavedState& state) const {
  return fmi::serialize(dynamic_cast<const Snapshot&>(state), token());
}

std::unique_ptr<SavedState> CellInstance::deserialize(const std::uint8_t* bytes, std::size_t size) const {
  return std::make_unique<Snapshot>(fmi::deserialize(bytes, size, layout_, token()));
}

void CellInstance::before_get(const Variable& variable) {
  if (!outputs_fresh_ &&
      (variable.causality == Causality::kOutput || variable.causality == Causality::kIndependent)) {
    refresh_outputs();
  }
  if (!ahead_fresh_ && is_path_ahead(variable)) refresh_path_ahead();
  // Inputs that were not set start at the home pose of the cell, which must be loaded first.
  if (variable.causality == Causality::kInput && phase_ == Phase::kInitialization) cell();
}

void CellInstance::after_set(const Variable& variable) {
  if (variable.type == Type::kReal) {
    const auto homes = home_inputs(values_.inputs);
    const auto home = std::find(homes.begin(), homes.end(), &member<double>(variable));
    if (home != homes.end()) home_inputs_set_[static_cast<std::size_t>(home - homes.begin())] = true;
  }
  if (variable.causality == Causality::kParameter) {
    cell_.reset();
    outputs_fresh_ = false;
  }
}

bool CellInstance::is_path_ahead(const Variable& variable) const {
  const auto* value = static_cast<const double*>(variable.value);
  const double* first = &values_.path_ahead[0];
  return std::less_equal<>()(first, value) && std::less<>()(value, first + values_.path_ahead.size());
}

void CellInstance::refresh_path_ahead() {
  const control::PathAhead ahead = cell().path_ahead();
  auto value = values_.path_ahead.begin();
  for (const control::Axes& axes : ahead) {
    value = std::copy_n(axes.begin(), layout_.joints.size(), value);
    value = std::copy_n(axes.begin() + kTableAxis, 1 + layout_.axes.size(), value);
  }
  ahead_fresh_ = true;
}

void CellInstance::refresh_outputs() {
  if (phase_ == Phase::kInstantiated) reject_call("getting an output", phase_);
  cell().write_outputs(values_.outputs);
  ahead_fresh_ = false;
  for (double* time : table().instants()) *time = *time == kNoInstant ? 0 : *time + start_time_;
  values_.time = communication_time_;
  if (!table().records().empty()) refresh_records();
  outputs_fresh_ = true;
}

/// Copies the variables of every record of the last step to its place in the arrays of the records.
void CellInstance::refresh_records() {
  const TriggerRecord current = values_.outputs.trigger;
  const std::vector<TriggerRecord>& records = cell().records();
  values_.record_count = cell().new_records();
  for (std::size_t k = 0; k < records.size(); ++k) {
    values_.outputs.trigger = records[k];
    values_.outputs.trigger.time += start_time_;
    for (const RecordColumn& column : table().records()) column.copy(k);
  }
  for (const RecordColumn& column : table().records()) column.clear_from(records.size());
  values_.outputs.trigger = current;
}

}  // namespace robotcell::fmi
