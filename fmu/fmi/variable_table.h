// The variables of the FMU, the single source of both FMI versions and their model descriptions.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "fmu/model/cell_values.h"
#include "fmu/model/fields.h"

namespace robotcell::fmi {

/// Storage of the variables of one instance.
struct Values {
  explicit Values(const CellLayout& layout)
      : inputs(layout),
        outputs(layout),
        path_ahead(control::PathAhead().size() * (layout.joints.size() + 1 + layout.axes.size())) {}

  double time = 0;
  CellParameters parameters;
  CellInputs inputs;
  CellOutputs outputs;
  PerDevice<double> path_ahead;   // of joints, table and further axes at each point; written on demand
  std::int32_t record_count = 0;  // of the records that the last step published
};

/// An enumeration is stored as std::int32_t.
enum class Type { kReal, kInteger, kBoolean, kString, kEnumeration };
/// Variable type of a C++ type; a variable of any other type does not compile.
template <class T>
struct TypeOf;
template <>
struct TypeOf<double> : std::integral_constant<Type, Type::kReal> {};
template <>
struct TypeOf<std::int32_t> : std::integral_constant<Type, Type::kInteger> {};
template <>
struct TypeOf<bool> : std::integral_constant<Type, Type::kBoolean> {};
template <>
struct TypeOf<std::string> : std::integral_constant<Type, Type::kString> {};

enum class Causality { kIndependent, kParameter, kInput, kOutput };
/// A variable; its index in the table is its value reference.
struct Variable {
  std::string name;
  Type type;
  Causality causality;
  Variability variability;
  Unit unit;
  std::string description;
  void* value;               // pointer to its member of Values
  double min = -kUnbounded;  // bounds of a number
  double max = kUnbounded;
  std::vector<std::uint32_t>
      initial_dependencies;  // parameters on which the initial value of an output depends
  const Enumeration* enumeration = nullptr;
  bool instant = false;                   // a simulation time; the model counts it from the start
  bool clocked = false;                   // changes only with the clock of the trigger records
  std::vector<std::uint32_t> dimensions;  // of an array (FMI 3), whose elements follow each other at `value`
};

inline bool is_array(const Variable& variable) { return !variable.dimensions.empty(); }

/// Number of elements of an array; 1 for a scalar.
std::size_t scalars_of(const Variable& variable);

inline bool is_settable(const Variable& variable) {
  return variable.causality == Causality::kInput || variable.causality == Causality::kParameter;
}

/// Whether values out of range are clamped, with a warning: Real inputs, since a sum that should be 1 may be
/// 1 + 1e-16.
inline bool is_clamped(const Variable& variable) {
  return variable.type == Type::kReal && variable.causality == Causality::kInput;
}

/// Whether the value changes within communication steps, so that intermediate updates can show it.
inline bool changes_in_steps(const Variable& variable) {
  return variable.causality == Causality::kOutput && variable.variability == Variability::kContinuous;
}

/// Message: `value` is out of the bounds of a number.
std::string out_of_range(const Variable& variable, double value);

/// The path ahead of the controller: not described, a scalar for each point and axis, or one array.
enum class PathAheadVariables { kNone, kScalars, kArray };

/// Groups of variables that are described on request only. Few importers read arrays, and the path ahead has
/// more scalars than everything else.
struct TableOptions {
  PathAheadVariables path_ahead = PathAheadVariables::kNone;
  bool records = false;  // arrays of the records that the last step published
};

/// All options but the default ones that a version of FMI has.
std::vector<TableOptions> table_options(int version);

constexpr std::size_t kMaxRecords = 256;  // in the arrays of records

/// An array of a number of all records, and the variable of the current record whose values it takes.
struct RecordColumn {
  const void* source;
  std::shared_ptr<std::vector<double>> reals;  // one of the two is used
  std::shared_ptr<std::vector<std::int32_t>> integers;

  explicit RecordColumn(const Variable& variable);
  /// Copies the present value to a place in the array.
  void copy(std::size_t place) const;
  /// Sets all places from one on to 0.
  void clear_from(std::size_t place) const;
  void* data() const { return reals ? static_cast<void*>(reals->data()) : integers->data(); }
};

/// The variables of a cell with a given layout, bound to the values of one instance.
class VariableTable {
 public:
  /// The values must outlive the table and keep their addresses.
  VariableTable(const CellLayout& layout, Values& values, const TableOptions& options = {});
  /// A table of other variables.
  explicit VariableTable(std::vector<Variable> variables);

  const std::vector<Variable>& variables() const { return variables_; }
  /// Throws std::invalid_argument where there is no such variable.
  const Variable& at(std::uint32_t reference) const;
  /// Values that are simulation times.
  const std::vector<double*>& instants() const { return instants_; }
  /// Arrays of the records; empty where they are not described.
  const std::vector<RecordColumn>& records() const { return records_; }

  /// Makes integers of all enumerations, for model descriptions. Does not change the token of the instance.
  void use_integers();

  /// Value reference of the clock that ticks with every trigger record (FMI 3 only), after all variables.
  std::uint32_t record_clock_reference() const { return static_cast<std::uint32_t>(variables_.size()); }

  /// Identifies the table: equal for the library and all model descriptions of cells of the same layout. The
  /// variant with arrays has a token of its own.
  std::string token(bool arrays) const;

 private:
  std::vector<Variable> variables_;
  std::vector<double*> instants_;
  std::vector<RecordColumn> records_;
};

/// The member that holds the value of a variable.
template <class T>
T& member(const Variable& variable) {
  return *static_cast<T*>(variable.value);
}

}  // namespace robotcell::fmi
