// The variables of the FMU, the single source of both FMI versions and their model descriptions.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

#include "fmu/model/cell_values.h"
#include "fmu/model/fields.h"

namespace robotcell::fmi {

/// Storage of the variables of one instance.
struct Values {
  explicit Values(const CellLayout& layout) : inputs(layout), outputs(layout) {}

  double time = 0;
  CellParameters parameters;
  CellInputs inputs;
  CellOutputs outputs;
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
  bool instant = false;  // a simulation time; the model counts it from the start
};

inline bool is_settable(const Variable& variable) {
  return variable.causality == Causality::kInput || variable.causality == Causality::kParameter;
}

/// Message: `value` is out of the bounds of a number.
std::string out_of_range(const Variable& variable, double value);

/// The variables of a cell with a given layout, bound to the values of one instance.
class VariableTable {
 public:
  /// The values must outlive the table and keep their addresses.
  VariableTable(const CellLayout& layout, Values& values);
  /// A table of other variables.
  explicit VariableTable(std::vector<Variable> variables);

  const std::vector<Variable>& variables() const { return variables_; }
  /// Throws std::invalid_argument where there is no such variable.
  const Variable& at(std::uint32_t reference) const;
  /// Values that are simulation times.
  const std::vector<double*>& instants() const { return instants_; }

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
};

/// The member that holds the value of a variable.
template <class T>
T& member(const Variable& variable) {
  return *static_cast<T*>(variable.value);
}

}  // namespace robotcell::fmi
