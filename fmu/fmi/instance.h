// One instance of an FMU, independent of the FMI version and of the model: phases, variables, time, states,
// log.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "fmu/fmi/entries.h"
#include "fmu/fmi/log.h"
#include "fmu/fmi/phase.h"
#include "fmu/fmi/variable_table.h"
#include "fmu/model/events.h"

namespace robotcell::fmi {

/// Options of an FMI 3 importer for events and early return; defaults for FMI 2.
struct StepOptions {
  bool event_mode = false;
  bool early_return = false;
  /// Called at every controller cycle within a step, with the time. Returns the time at which the importer
  /// requests the end of the step, if it does.
  std::function<std::optional<double>(double time)> intermediate;
  /// References of the variables that the importer reads in intermediate updates; empty: not stated.
  std::vector<std::uint32_t> intermediate_variables;
};

struct StepResult {
  bool event = false;  // an event occurred and the importer uses event mode
  bool early = false;  // the step ended before its planned end
};

/// What the states of all models hold.
struct SavedPhase {
  Phase phase = Phase::kInstantiated;
  double start_time = 0;
  double stop_time = 0;  // infinite where not defined
  double communication_time = 0;
};

/// Complete state of an instance (FMUState).
class SavedState {
 public:
  SavedState() = default;
  SavedState(const SavedState&) = default;
  SavedState& operator=(const SavedState&) = default;
  virtual ~SavedState() = default;
  /// Takes the values of another state of the same model.
  virtual void assign(const SavedState& other) = 0;
};

/// All functions throw std::exception on an illegal argument or call. The C functions return Error then,
/// after which only restoring a state, reset, getters and free are allowed, as the standards say.
class Instance {
 public:
  virtual ~Instance() = default;
  Instance(const Instance&) = delete;
  Instance& operator=(const Instance&) = delete;

  const std::string& name() const { return name_; }
  /// Of the variant with scalars and without groups on request; all variants exchange states.
  const std::string& token() const { return token_; }
  const VariableTable& table() const { return table_; }

  /// Switches to the variant of the model description with this token, of an FMI version; false where there
  /// is none.
  virtual bool use_variant(const std::string& token, int version);
  /// Checks the references of `intermediate_variables`; call it when the variant is known.
  void check_intermediate_variables() const;

  /// Number of scalars behind a reference: more than one for an array.
  std::size_t size_of(std::uint32_t reference) const;
  std::uint32_t record_clock_reference() const { return table_.record_clock_reference(); }
  Log& log() { return log_; }

  /// Enters the error state; during an intermediate update when it has ended.
  void fail();
  /// Whether a callback of the importer runs, from which it must not free the instance.
  bool in_callback() const { return log_.is_writing() || phase_ == Phase::kIntermediate; }

  void setup(double start_time, std::optional<double> stop_time = std::nullopt);
  void enter_initialization();
  void exit_initialization();
  void terminate();
  void reset();
  virtual StepResult do_step(double current, double step) = 0;
  void enter_event_mode();
  void enter_step_mode();
  void require_event() const;
  void update_discrete_states();
  /// Whether the record clock ticks in the present event.
  bool record_clock() const;
  double last_successful_time() const { return communication_time_; }

  /// Value of a scalar of a variable. T is double, std::int32_t (also for an enumeration), bool or
  /// std::string.
  template <class T>
  T& get(std::uint32_t reference, std::size_t element, Type type);
  template <class T>
  T& get(std::uint32_t reference) {
    return get<T>(reference, 0, accessed_type<T>(reference));
  }
  /// Returns false where an input was clamped to its bounds, with a warning.
  template <class T>
  bool set(std::uint32_t reference, const T& value, Type type);
  template <class T>
  bool set(std::uint32_t reference, const T& value) {
    return set<T>(reference, value, accessed_type<T>(reference));
  }

  /// Type of a variable that a function for values of type T accesses: FMI 2 has no other function for
  /// enumerations, and in FMI 3 they may be described as integers.
  template <class T>
  Type accessed_type(std::uint32_t reference) const {
    const bool known = reference < table_.variables().size();
    const bool enumeration = known && table_.variables()[reference].type == Type::kEnumeration;
    return TypeOf<T>::value == Type::kInteger && enumeration ? Type::kEnumeration : TypeOf<T>::value;
  }

  virtual std::unique_ptr<SavedState> snapshot() const = 0;
  virtual void restore(const SavedState& state) = 0;
  virtual std::vector<std::uint8_t> serialize(const SavedState& state) const = 0;
  virtual std::unique_ptr<SavedState> deserialize(const std::uint8_t* bytes, std::size_t size) const = 0;

 protected:
  Instance(std::string name, Log log, StepOptions options);

  /// Sets the variables; their values belong to the model.
  void set_table(VariableTable table);
  /// Enters the variant with array variables.
  void merge_arrays();

  /// Called where initialization ends; checks the start values.
  virtual void start() = 0;
  /// Resets all values.
  virtual void clear() = 0;
  /// Called before a value is read and after it was set.
  virtual void before_get(const Variable& /*variable*/) {}
  virtual void after_set(const Variable& /*variable*/) {}

  /// Checks a step, and returns its planned end, microseconds from the start.
  std::int64_t begin_step(double current, double step) const;
  /// Sets the time at the end of a step; returns whether it ended before its planned end.
  bool end_step(double current, double step, std::int64_t reached);
  /// Calls the importer within a step; returns the new end of the step.
  std::int64_t intermediate_update(std::int64_t now, std::int64_t end);

  SavedPhase saved_phase() const;
  void restore_phase(const SavedPhase& saved);
  /// Throws std::exception where a state in this phase cannot be restored now.
  void check_restorable(Phase saved) const;
  /// Throws std::invalid_argument where an input or parameter is out of range.
  void check_bounds() const;

  Log log_;
  StepOptions options_;
  Phase phase_ = Phase::kInstantiated;
  double start_time_ = 0;
  double communication_time_ = 0;
  Events events_ = 0;  // of the last step, not yet handled

 private:
  const Variable& variable(std::uint32_t reference, std::size_t element, Type type) const;
  void check_settable(const Variable& variable) const;
  void check_readable(const Variable& variable) const;
  double within_bounds(const Variable& variable, double value) const;
  std::int64_t microseconds_to(double time) const;
  void set_time(std::int64_t ticks);

  std::string name_;
  double stop_time_;
  bool intermediate_failed_ = false;  // a call during the present intermediate update
  VariableTable table_;
  std::string token_;
  std::vector<std::uint32_t> array_sizes_;  // by reference, 0 within an array; empty without merged arrays
};

/// Creates an instance of the FMU's model: defined by each FMU.
std::unique_ptr<Instance> make_instance(const std::string& name, const std::string& resource_location,
                                        const Log& log, const StepOptions& options);

}  // namespace robotcell::fmi
