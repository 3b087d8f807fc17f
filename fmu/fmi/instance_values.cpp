// Getting and setting the variables of an instance.
#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>

#include "fmu/fmi/instance.h"

namespace robotcell::fmi {

bool Instance::use_arrays(const std::string& token) {
  if (token != table_.token(true)) return false;
  array_sizes_.assign(table_.variables().size(), 0);
  for (const Entry& entry : list_entries(table_.variables(), true)) {
    array_sizes_[entry.reference] = entry.size;
  }
  return true;
}

std::size_t Instance::array_size(std::uint32_t reference) const {
  if (reference >= array_sizes_.size() || array_sizes_[reference] == 0) {
    throw std::invalid_argument("unknown value reference " + std::to_string(reference));
  }
  return array_sizes_[reference];
}

const Variable& Instance::variable(std::uint32_t reference, Type type) const {
  const Variable& found = table_.at(reference);
  if (found.type != type) {
    throw std::invalid_argument(found.name + " has another type than the called function");
  }
  return found;
}

Type Instance::integer_type(std::uint32_t reference) const {
  const bool known = reference < table_.variables().size();
  return known && table_.variables()[reference].type == Type::kEnumeration ? Type::kEnumeration
                                                                           : Type::kInteger;
}

bool Instance::is_path_ahead(const Variable& variable) const {
  const auto* value = static_cast<const control::Axes*>(variable.value);
  const control::PathAhead& ahead = values_.outputs.ahead;
  return std::less_equal<>()(ahead.data(), value) && std::less<>()(value, ahead.data() + ahead.size());
}

template <class T>
T& Instance::get(std::uint32_t reference, Type type) {
  const Variable& found = variable(reference, type);
  if (!outputs_fresh_ &&
      (found.causality == Causality::kOutput || found.causality == Causality::kIndependent)) {
    refresh_outputs();
  }
  if (!ahead_fresh_ && is_path_ahead(found)) {
    values_.outputs.ahead = cell().path_ahead();
    ahead_fresh_ = true;
  }
  // Inputs that were not set start at the home pose of the cell, which must be loaded first.
  if (found.causality == Causality::kInput && phase_ == Phase::kInitialization) cell();
  return member<T>(found);
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

/// Input values of type Real are clamped to their bounds with a warning, since a sum that should be 1 may be
/// 1 + 1e-16; any other value out of range is an error.
double Instance::within_bounds(const Variable& variable, double value) const {
  const double inside = std::clamp(value, variable.min, variable.max);
  if (inside == value) return value;
  const bool clamps = variable.type == Type::kReal && variable.causality == Causality::kInput;
  const std::string text = out_of_range(variable, value);
  if (!clamps) throw std::invalid_argument(text);
  log_.write(LogCategory::kWarning, text + ": clamped");
  return inside;
}

template <class T>
bool Instance::set(std::uint32_t reference, const T& value, Type type) {
  const Variable& found = variable(reference, type);
  check_settable(found);
  T accepted = value;
  if constexpr (std::is_same_v<T, double>) {
    if (!std::isfinite(value)) {
      throw std::invalid_argument(found.name + " must be a finite number, not " + std::to_string(value));
    }
  }
  if constexpr (std::is_same_v<T, double> || std::is_same_v<T, std::int32_t>) {
    accepted = static_cast<T>(within_bounds(found, value));
  }
  member<T>(found) = accepted;
  if constexpr (std::is_same_v<T, double>) {
    const auto homes = home_inputs(values_.inputs);
    const auto home = std::find(homes.begin(), homes.end(), &member<T>(found));
    if (home != homes.end()) home_inputs_set_[static_cast<std::size_t>(home - homes.begin())] = true;
  }
  if (found.causality == Causality::kParameter) {
    cell_.reset();
    outputs_fresh_ = false;
  }
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

template double& Instance::get(std::uint32_t, Type);
template std::int32_t& Instance::get(std::uint32_t, Type);
template bool& Instance::get(std::uint32_t, Type);
template std::string& Instance::get(std::uint32_t, Type);
template bool Instance::set(std::uint32_t, const double&, Type);
template bool Instance::set(std::uint32_t, const std::int32_t&, Type);
template bool Instance::set(std::uint32_t, const bool&, Type);
template bool Instance::set(std::uint32_t, const std::string&, Type);

void Instance::refresh_outputs() {
  if (phase_ == Phase::kInstantiated) reject_call("getting an output", phase_);
  cell().write_outputs(values_.outputs);
  ahead_fresh_ = false;
  for (double* time : table_.instants()) *time = *time == kNoInstant ? 0 : *time + start_time_;
  values_.time = communication_time_;
  outputs_fresh_ = true;
}

}  // namespace robotcell::fmi
