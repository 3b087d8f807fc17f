// Getting and setting the variables of an instance.
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "fmu/fmi/instance.h"
#include "fmu/fmi/number_text.h"

namespace robotcell::fmi {

bool Instance::use_variant(const std::string& token, int version) {
  if (token == table_.token(false)) return true;
  if (version != 3 || token != table_.token(true)) return false;
  merge_arrays();
  return true;
}

void Instance::merge_arrays() {
  array_sizes_.assign(table_.variables().size(), 0);
  for (const Entry& entry : list_entries(table_.variables(), true)) {
    array_sizes_[entry.reference] = entry.size;
  }
}

std::size_t Instance::size_of(std::uint32_t reference) const {
  const Variable& found = table_.at(reference);
  return array_sizes_.empty() || is_array(found) ? scalars_of(found) : array_sizes_[reference];
}

const Variable& Instance::variable(std::uint32_t reference, std::size_t element, Type type) const {
  const Variable& found = table_.at(reference);
  if (found.type != type) {
    throw std::invalid_argument(found.name + " has another type than the called function");
  }
  if (element >= scalars_of(found)) {
    throw std::invalid_argument(found.name + " has no element " + std::to_string(element + 1));
  }
  return found;
}

void Instance::check_intermediate_variables() const {
  for (const std::uint32_t reference : options_.intermediate_variables) {
    const Variable& found = table_.at(reference);
    if (changes_in_steps(found) || found.causality == Causality::kIndependent) continue;
    throw std::invalid_argument(found.name + " has no intermediate values: only continuous outputs have");
  }
}

/// In an intermediate update only the variables can be read that have values there, of those that the
/// importer stated if it stated any.
void Instance::check_readable(const Variable& variable) const {
  if (phase_ != Phase::kIntermediate || variable.causality == Causality::kIndependent) return;
  if (!changes_in_steps(variable)) reject_call("getting " + variable.name, phase_);
  const auto& stated = options_.intermediate_variables;
  const auto index = static_cast<std::uint32_t>(&variable - table_.variables().data());
  const auto contains = [&](std::uint32_t reference) {
    return index >= reference && index < reference + (array_sizes_.empty() ? 1 : array_sizes_[reference]);
  };
  if (stated.empty() || std::any_of(stated.begin(), stated.end(), contains)) return;
  throw std::logic_error("getting " + variable.name +
                         ", which is not among requiredIntermediateVariables, is not allowed during an "
                         "intermediate update");
}

template <class T>
T& Instance::get(std::uint32_t reference, std::size_t element, Type type) {
  const Variable& found = variable(reference, element, type);
  check_readable(found);
  before_get(found);
  return (&member<T>(found))[element];
}

void Instance::check_settable(const Variable& variable) const {
  const bool early = phase_ == Phase::kInstantiated || phase_ == Phase::kInitialization;
  const bool input = variable.causality == Causality::kInput;
  if (!is_settable(variable)) {
    throw std::invalid_argument(variable.name + " is neither an input nor a parameter");
  }
  // All inputs are discrete: importers that use event mode set them there.
  const Phase open = options_.event_mode ? Phase::kEvent : Phase::kStepping;
  if (!early && !(input && phase_ == open)) reject_call("setting " + variable.name, phase_);
}

/// Where values are clamped to their bounds, a warning says so; any other value out of range is an error.
double Instance::within_bounds(const Variable& variable, double value) const {
  const double inside = std::clamp(value, variable.min, variable.max);
  if (inside == value) return value;
  const std::string text = out_of_range(variable, value);
  if (!is_clamped(variable)) throw std::invalid_argument(text);
  log_.write(LogCategory::kWarning, text + ": clamped");
  return inside;
}

template <class T>
bool Instance::set(std::uint32_t reference, const T& value, Type type) {
  const Variable& found = variable(reference, 0, type);
  check_settable(found);
  T accepted = value;
  if constexpr (std::is_same_v<T, double>) {
    if (!std::isfinite(value)) {
      throw std::invalid_argument(found.name + " must be a finite number, not " + number_text(value));
    }
  }
  if constexpr (std::is_same_v<T, double> || std::is_same_v<T, std::int32_t>) {
    accepted = static_cast<T>(within_bounds(found, value));
  }
  member<T>(found) = accepted;
  after_set(found);
  return accepted == value;
}

void Instance::check_bounds() const {
  for (const Variable& variable : table_.variables()) {
    if (!is_settable(variable)) continue;
    double value = 0;
    if (variable.type == Type::kReal) value = member<double>(variable);
    const bool whole = variable.type == Type::kInteger || variable.type == Type::kEnumeration;
    if (whole) value = member<std::int32_t>(variable);
    const bool number = variable.type == Type::kReal || whole;
    if (!number || (value >= variable.min && value <= variable.max)) continue;
    throw std::invalid_argument("the state holds a value of " + variable.name + " that is out of range");
  }
}

template double& Instance::get(std::uint32_t, std::size_t, Type);
template std::int32_t& Instance::get(std::uint32_t, std::size_t, Type);
template bool& Instance::get(std::uint32_t, std::size_t, Type);
template std::string& Instance::get(std::uint32_t, std::size_t, Type);
template bool Instance::set(std::uint32_t, const double&, Type);
template bool Instance::set(std::uint32_t, const std::int32_t&, Type);
template bool Instance::set(std::uint32_t, const bool&, Type);
template bool Instance::set(std::uint32_t, const std::string&, Type);

}  // namespace robotcell::fmi
