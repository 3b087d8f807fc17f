// The border to C: no exception passes it.
#pragma once

#include <exception>
#include <string>
#include <vector>

#include "fmu/fmi/instance.h"

namespace robotcell::fmi {

/// Runs one call of the importer; true on success. What is thrown becomes a message, and the instance fails.
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

/// Switches categories of messages (`change` is a member of Log); true when all names are known.
template <class Change>
bool switch_logging(Instance& instance, const char* function, Change change, bool on, std::size_t n,
                    const char* const* names) {
  std::vector<std::string> wanted;
  if (n > 0 && names == nullptr) throw std::invalid_argument("null pointer");
  for (std::size_t i = 0; i < n; ++i) {
    if (names[i] == nullptr) throw std::invalid_argument("null string");
    wanted.emplace_back(names[i]);
  }
  const std::string unknown = (instance.log().*change)(on, wanted);
  if (unknown.empty()) return true;
  instance.log().write(LogCategory::kWarning,
                       std::string(function) + ": there is no category '" + unknown + "'");
  return false;
}

inline void require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(message);
}

}  // namespace robotcell::fmi
