// One instance of the FMU, independent of the FMI version: phases, values, time, states, log.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "fmu/fmi/entries.h"
#include "fmu/fmi/log.h"
#include "fmu/fmi/snapshot.h"
#include "fmu/fmi/variable_table.h"
#include "fmu/model/cell.h"

namespace robotcell::fmi {

/// Options of an FMI 3 importer for events and early return; defaults for FMI 2.
struct StepOptions {
  bool event_mode = false;
  bool early_return = false;
  /// Called at every controller cycle within a step, with the time. Returns the time at which the importer
  /// requests the end of the step, if it does.
  std::function<std::optional<double>(double time)> intermediate;
};

/// A cell description loaded from a file.
struct LoadedCell {
  std::string path;
  std::uint64_t hash = 0;       // of the file content
  CellDescription description;  // without the meshes of the bodies
  proximity::BodySet bodies;
};

/// Loads a description. `known` is reused where the file is the same, else its bounding volumes of equal
/// meshes. Throws DescriptionError that names the file.
std::shared_ptr<const LoadedCell> load_cell(const std::string& path,
                                            const std::shared_ptr<const LoadedCell>& known = nullptr);

struct StepResult {
  bool event = false;  // an event occurred and the importer uses event mode
  bool early = false;  // the step ended before its planned end
};

/// All functions throw std::exception on an illegal argument or call. The C functions return Error then,
/// after which only restoring a state, reset, terminate, getters and free are allowed.
class Instance {
 public:
  /// Loads the cell in the FMU's resources, whose layout determines the variables.
  Instance(std::string name, std::string resource_location, Log log, StepOptions options = {});

  const std::string& name() const { return name_; }
  const CellLayout& layout() const { return layout_; }
  const std::string& token() const { return token_; }

  /// Switches to the variant with array variables; false where the token is not that of this variant.
  bool use_arrays(const std::string& token);
  /// Number of scalars behind a reference: more than one for an array.
  std::size_t size_of(std::uint32_t reference) const {
    return array_sizes_.empty() ? 1 : array_size(reference);
  }

  std::uint32_t record_clock_reference() const { return table_.record_clock_reference(); }
  Log& log() { return log_; }
  void fail() { phase_ = Phase::kFailed; }

  void setup(double start_time, std::optional<double> stop_time);
  void enter_initialization();
  void exit_initialization();
  void terminate();
  void reset();
  StepResult do_step(double current, double step);
  void enter_event_mode();
  void enter_step_mode();
  void require_event() const;
  void update_discrete_states();
  /// Whether the record clock ticks in the present event.
  bool record_clock() const;
  double last_successful_time() const { return communication_time_; }

  /// T is double, std::int32_t (also for an enumeration), bool or std::string.
  template <class T>
  T& get(std::uint32_t reference, Type type = TypeOf<T>::value);
  /// Returns false where an input was clamped to its bounds, with a warning.
  template <class T>
  bool set(std::uint32_t reference, const T& value, Type type = TypeOf<T>::value);

  /// Type of an integer or enumeration: the functions for integers serve both.
  Type integer_type(std::uint32_t reference) const;

  Snapshot snapshot() const;
  void restore(const Snapshot& snapshot);

 private:
  const Variable& variable(std::uint32_t reference, Type type) const;
  void check_settable(const Variable& variable) const;
  double within_bounds(const Variable& variable, double value) const;
  /// Throws std::invalid_argument where an input or parameter is out of range.
  void check_bounds() const;
  std::size_t array_size(std::uint32_t reference) const;
  void refresh_outputs();
  bool is_path_ahead(const Variable& variable) const;
  Cell& cell();
  void start_unset_inputs(const CellDescription& cell);
  std::string description_path(const std::string& file) const;
  std::int64_t microseconds_to(double time) const;
  void check_step(double current, double step) const;
  std::int64_t intermediate_update(std::int64_t now, std::int64_t end);
  void set_time(std::int64_t ticks);
  void log_refusal();
  void log_step(Events happened, bool early);

  std::string name_;
  std::string resource_location_;
  Log log_;
  StepOptions options_;
  Phase phase_ = Phase::kInstantiated;
  double start_time_ = 0;
  double stop_time_;
  double communication_time_ = 0;
  std::shared_ptr<const LoadedCell> default_cell_;  // the description in the FMU's resources
  std::shared_ptr<const LoadedCell> loaded_;        // the description loaded last
  CellLayout layout_;
  Values values_;
  HomeInputFlags home_inputs_set_{};  // set by the importer; other home inputs follow the loaded cell
  VariableTable table_;
  std::string token_;
  std::vector<std::uint32_t> array_sizes_;  // by reference, 0 within an array; empty without arrays
  bool outputs_fresh_ = false;
  bool ahead_fresh_ = false;  // the path ahead is evaluated only where it is read
  Events events_ = 0;         // of the last step, not yet handled
  std::int32_t logged_limit_ = 0;
  std::string logged_refusal_;
  std::unique_ptr<Cell> cell_;  // created from loaded_
};

}  // namespace robotcell::fmi
