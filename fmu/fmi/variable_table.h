// The one list of the FMU's variables: both FMI versions and both model descriptions are made from it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

#include "fmu/model/cell_values.h"

namespace robotcell::fmi {

/// The memory behind the variables of one instance.
struct Values {
  explicit Values(const CellLayout& layout) : inputs(layout), outputs(layout) {}

  double time = 0;
  CellParameters parameters;
  CellInputs inputs;
  CellOutputs outputs;
};

enum class Type { kReal, kInteger, kBoolean, kString };
/// The type of a variable with a member of type T.
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
  const char* name;      // "" for a number without unit
  const char* display;   // "" for none
  const char* quantity;  // name of the declared type; "" for none
};

/// A variable; its position in the table is its value reference.
struct Variable {
  std::string name;
  Type type;
  Causality causality;
  Variability variability;
  Unit unit;
  std::string description;
  void* where;                                      // its member of Values
  std::int32_t min = 0, max = 0;                    // of an integer, where max > min
  std::vector<std::uint32_t> initial_dependencies;  // parameters on which an output's initial value depends
};

/// The variables of a cell of one layout, bound to the values of one instance.
class VariableTable {
 public:
  /// The values must outlive the table, and stay where they are.
  VariableTable(const CellLayout& layout, Values& values);

  const std::vector<Variable>& variables() const { return variables_; }

  /// Value reference of the clock that ticks with every trigger record; FMI 3 alone has it, behind all
  /// variables.
  std::uint32_t record_clock_reference() const { return static_cast<std::uint32_t>(variables_.size()); }

  /// Identifies the table: equal for the library and every model description that was made with it for cells
  /// of the same layout. The variant with arrays has another.
  std::string token(bool arrays) const;

 private:
  std::vector<Variable> variables_;
};

/// The member behind a variable.
template <class T>
T& member(const Variable& variable) {
  return *static_cast<T*>(variable.where);
}

}  // namespace robotcell::fmi
