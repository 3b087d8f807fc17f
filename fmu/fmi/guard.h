// The border to C: no exception passes it.
#pragma once

#include <exception>
#include <string>

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
    instance->log(std::string(function) + ": " + message);
  } catch (...) {
    instance->fail();
  }
  return false;
}

inline void require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(message);
}

}  // namespace robotcell::fmi
