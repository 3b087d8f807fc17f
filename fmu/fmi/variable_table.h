// The variables of the FMU, the single source of both FMI versions and their model descriptions.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

#include "fmu/model/cell_values.h"

namespace robotcell::fmi {

/// Storage of the variables of one instance.
struct Values {
  explicit Values(const CellLayout& layout) : inputs(layout), outputs(layout) {}

  double time = 0;
  CellParameters parameters;
  CellInputs inputs;
  CellOutputs outputs;
};

enum class Type { kReal, kInteger, kBoolean, kString };
/// Variable type of a C++ type.
template <class T>
constexpr Type type_of() {
  if constexpr (std::is_same_v<T, double>) return Type::kReal;
  if constexpr (std::is_same_v<T, std::int32_t>) return Type::kInteger;
  if constexpr (std::is_same_v<T, bool>) return Type::kBoolean;
  return Type::kString;
}

enum class Causality { kIndependent, kParameter, kInput, kOutput };
enum class Variability { kFixed, kDiscrete, kContinuous };

struct Unit {
  const char* name;      // "" for a dimensionless number
  const char* display;   // "" for none
  const char* quantity;  // name of the declared type; "" for none
};

/// A variable; its index in the table is its value reference.
struct Variable {
  std::string name;
  Type type;
  Causality causality;
  Variability variability;
  Unit unit;
  std::string description;
  void* value;                    // pointer to its member of Values
  std::int32_t min = 0, max = 0;  // of an integer, used where max > min
  std::vector<std::uint32_t>
      initial_dependencies;  // parameters on which the initial value of an output depends
};

/// The variables of a cell with a given layout, bound to the values of one instance.
class VariableTable {
 public:
  /// The values must outlive the table and keep their addresses.
  VariableTable(const CellLayout& layout, Values& values);

  const std::vector<Variable>& variables() const { return variables_; }

  /// Value reference of the clock that ticks with every trigger record (FMI 3 only), after all variables.
  std::uint32_t record_clock_reference() const { return static_cast<std::uint32_t>(variables_.size()); }

  /// Identifies the table: equal for the library and all model descriptions of cells of the same layout. The
  /// variant with arrays has a token of its own.
  std::string token(bool arrays) const;

 private:
  std::vector<Variable> variables_;
};

/// The member that holds the value of a variable.
template <class T>
T& member(const Variable& variable) {
  return *static_cast<T*>(variable.value);
}

}  // namespace robotcell::fmi
