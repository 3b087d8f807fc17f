// Boundary to the C interface: no exception passes it.
#pragma once

#include <exception>
#include <string>
#include <vector>

#include "fmu/fmi/instance.h"

namespace robotcell::fmi {

/// Type of a variable that a function for values of type T accesses: FMI 2 has no other function for
/// enumerations, and in FMI 3 they may be described as integers.
template <class T>
Type accessed_type(const Instance& instance, std::uint32_t reference) {
  if constexpr (std::is_same_v<T, std::int32_t>) return instance.integer_type(reference);
  return TypeOf<T>::value;
}

/// Runs one call of the importer; true on success. An exception is logged, and the instance enters the error
/// state.
template <class Call>
bool guarded(Instance* instance, const char* function, const Call& call) noexcept {
  if (instance == nullptr) return false;
  std::string message;
  try {
    try {
      call();
      return true;
    } catch (const std::exception& error) {
      message = error.what();
    } catch (...) {
      message = "unknown error";
    }
    instance->fail();
    instance->log().write(LogCategory::kError, std::string(function) + ": " + message);
  } catch (...) {
    instance->fail();
  }
  return false;
}

/// Switches log categories with a member function of Log; true where all names are known.
template <class SwitchFunction>
bool switch_logging(Instance& instance, const char* function, SwitchFunction switch_function, bool on,
                    std::size_t n, const char* const* names) {
  std::vector<std::string> categories;
  if (n > 0 && names == nullptr) throw std::invalid_argument("an argument is a null pointer");
  for (std::size_t i = 0; i < n; ++i) {
    if (names[i] == nullptr) throw std::invalid_argument("a string is a null pointer");
    categories.emplace_back(names[i]);
  }
  const std::string unknown = (instance.log().*switch_function)(on, categories);
  if (unknown.empty()) return true;
  instance.log().write(LogCategory::kWarning,
                       std::string(function) + ": unknown log category '" + unknown + "'");
  return false;
}

inline void require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(message);
}

}  // namespace robotcell::fmi
