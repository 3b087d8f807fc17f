// One instance of the FMU, free of either FMI version: phases, values, time, states, messages.
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

/// How the importer of FMI 3 wants to be told what happens inside a step. With FMI 2, nothing of it.
struct StepOptions {
  bool event_mode = false;
  bool early_return = false;
  /// Called at every cycle of the controller inside a step, with the time. Returns the time at which the
  /// importer wants the step to end, where it wants that.
  std::function<std::optional<double>(double time)> intermediate;
};

/// A description, and where it is from.
struct LoadedCell {
  std::string path;
  std::uint64_t hash = 0;  // of the file's bytes
  CellDescription description;
};

/// Throws DescriptionError that names the file.
LoadedCell load_cell(const std::string& path);

struct StepResult {
  bool event = false;  // there was an event, and the importer uses event mode
  bool early = false;  // the step ended before its end
};

/// Everything throws std::exception on an illegal argument or call; the C functions turn that into Error,
/// after which only state restoring, reset, terminate, getters and free are allowed.
class Instance {
 public:
  /// Reads the cell in the FMU's resources, whose layout decides which variables there are.
  Instance(std::string name, std::string resource_location, Log log, StepOptions options = {});

  const std::string& name() const { return name_; }
  const CellLayout& layout() const { return layout_; }
  const std::string& token() const { return token_; }

  /// Answers from now on as the variant whose variables are merged into arrays. Returns whether the token is
  /// that variant's.
  bool use_arrays(const std::string& token);
  /// Values behind a reference: more than one for an array.
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
  /// Whether the clock of the records ticks in the present event.
  bool record_clock() const;
  double last_successful_time() const { return communication_time_; }

  /// T is double, std::int32_t, bool or std::string.
  template <class T>
  T& get(std::uint32_t reference);
  template <class T>
  void set(std::uint32_t reference, const T& value);

  Snapshot snapshot() const;
  void restore(const Snapshot& snapshot);

 private:
  const Variable& variable(std::uint32_t reference, Type type) const;
  void check_settable(const Variable& variable) const;
  std::size_t array_size(std::uint32_t reference) const;
  void refresh_outputs();
  Cell& cell();
  std::string description_path(const std::string& file) const;
  std::int64_t ticks_to(double time) const;
  void check_step(double current, double step) const;
  std::int64_t next_stop(std::int64_t end) const;
  std::int64_t ask_importer(std::int64_t now, std::int64_t end);
  void now_at(std::int64_t ticks);
  void log_step(Events happened, bool early);

  std::string name_;
  std::string resource_location_;
  Log log_;
  StepOptions options_;
  Phase phase_ = Phase::kInstantiated;
  double start_time_ = 0;
  double stop_time_;
  double communication_time_ = 0;
  LoadedCell own_;
  CellLayout layout_;
  Values values_;
  VariableTable table_;
  std::string token_;
  std::vector<std::uint32_t> array_sizes_;  // by reference, 0 inside an array; empty without arrays
  bool outputs_fresh_ = false;
  Events events_ = 0;  // of the last step, and not dealt with yet
  std::int32_t logged_limit_ = 0;
  std::unique_ptr<Cell> cell_;
  std::uint64_t description_hash_ = 0;
};

}  // namespace robotcell::fmi
