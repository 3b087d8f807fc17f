// Getting and setting the variables of an instance.
#include <algorithm>
#include <cmath>
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
  if (reference >= table_.variables().size()) {
    throw std::invalid_argument("unknown value reference " + std::to_string(reference));
  }
  const Variable& found = table_.variables()[reference];
  if (found.type != type) {
    throw std::invalid_argument(found.name + " has another type than the called function");
  }
  return found;
}

template <class T>
T& Instance::get(std::uint32_t reference) {
  const Variable& found = variable(reference, type_of<T>());
  if (!outputs_fresh_ &&
      (found.causality == Causality::kOutput || found.causality == Causality::kIndependent)) {
    refresh_outputs();
  }
  // Inputs that were not set start at the home pose of the cell, which must be loaded first.
  if (found.causality == Causality::kInput && phase_ == Phase::kInitialization) cell();
  return member<T>(found);
}

void Instance::check_settable(const Variable& variable) const {
  const bool early = phase_ == Phase::kInstantiated || phase_ == Phase::kInitialization;
  const bool input = variable.causality == Causality::kInput;
  if (!input && variable.causality != Causality::kParameter) {
    throw std::invalid_argument(variable.name + " is neither an input nor a parameter");
  }
  // All inputs are discrete: importers that use event mode set them there.
  const Phase open = options_.event_mode ? Phase::kEvent : Phase::kStepping;
  if (!early && !(input && phase_ == open)) reject_call("setting " + variable.name, phase_);
}

template <class T>
void Instance::set(std::uint32_t reference, const T& value) {
  const Variable& found = variable(reference, type_of<T>());
  check_settable(found);
  if constexpr (std::is_same_v<T, double>) {
    if (!std::isfinite(value)) {
      throw std::invalid_argument(found.name + " must be a finite number, not " + std::to_string(value));
    }
  }
  if constexpr (std::is_same_v<T, std::int32_t>) {
    if (found.max > found.min && (value < found.min || value > found.max)) {
      throw std::invalid_argument(found.name + " must be from " + std::to_string(found.min) + " to " +
                                  std::to_string(found.max) + ", not " + std::to_string(value));
    }
  }
  member<T>(found) = value;
  if constexpr (std::is_same_v<T, double>) {
    const auto homes = home_inputs(values_.inputs);
    const auto home = std::find(homes.begin(), homes.end(), &member<T>(found));
    if (home != homes.end()) home_inputs_set_[static_cast<std::size_t>(home - homes.begin())] = true;
  }
  if (found.causality == Causality::kParameter) {
    cell_.reset();
    outputs_fresh_ = false;
  }
}

template double& Instance::get(std::uint32_t);
template std::int32_t& Instance::get(std::uint32_t);
template bool& Instance::get(std::uint32_t);
template std::string& Instance::get(std::uint32_t);
template void Instance::set(std::uint32_t, const double&);
template void Instance::set(std::uint32_t, const std::int32_t&);
template void Instance::set(std::uint32_t, const bool&);
template void Instance::set(std::uint32_t, const std::string&);

void Instance::refresh_outputs() {
  if (phase_ == Phase::kInstantiated) reject_call("getting an output", phase_);
  cell().write_outputs(values_.outputs);
  if (values_.outputs.trigger.index > 0) values_.outputs.trigger.time += start_time_;
  values_.time = communication_time_;
  outputs_fresh_ = true;
}

}  // namespace robotcell::fmi
