// One instance of the FMU, free of either FMI version: phases, values, time, states, messages.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "fmu/fmi/snapshot.h"
#include "fmu/fmi/variable_table.h"
#include "fmu/model/cell.h"

namespace robotcell::fmi {

/// Receives the text of an error.
using Logger = std::function<void(const std::string& message)>;

/// Everything throws std::exception on an illegal argument or call; the C functions turn that into Error,
/// after which only state restoring, reset, terminate, getters and free are allowed.
class Instance {
 public:
  Instance(std::string name, std::string resource_location, Logger logger);

  const std::string& name() const { return name_; }
  void log(const std::string& message) const;
  void fail() { phase_ = Phase::kFailed; }

  void setup(double start_time, std::optional<double> stop_time);
  void enter_initialization();
  void exit_initialization();
  void terminate();
  void reset();
  void do_step(double current, double step);
  double last_successful_time() const { return communication_time_; }
  void require_stepping(const char* what) const;

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
  void refresh_outputs();
  Cell& cell();
  std::string description_path() const;
  std::int64_t ticks_to(double time) const;

  std::string name_;
  std::string resource_location_;
  Logger logger_;
  Phase phase_ = Phase::kInstantiated;
  double start_time_ = 0;
  double stop_time_;
  double communication_time_ = 0;
  Values values_;
  bool outputs_fresh_ = false;
  std::unique_ptr<Cell> cell_;
  std::uint64_t description_hash_ = 0;
};

}  // namespace robotcell::fmi
