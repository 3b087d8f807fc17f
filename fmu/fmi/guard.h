// Boundary to the C interface: no exception passes it.
#pragma once

#include <cstring>
#include <exception>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "fmu/fmi/instance.h"

namespace robotcell::fmi {

/// Runs one call of the importer; true on success. An exception is logged, and the instance enters the error
/// state. A call from the log callback is refused and changes nothing, because the call that logs is not
/// finished.
template <class Call>
bool guarded(Instance* instance, const char* function, const Call& call) noexcept {
  if (instance == nullptr || instance->log().is_writing()) return false;
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

/// Frees an instance; no effect from a callback, whose caller still needs it.
inline void free_instance(Instance* instance) {
  if (instance != nullptr && !instance->in_callback()) delete instance;
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

inline SavedState& state_of(void* state) {
  if (state == nullptr) throw std::invalid_argument("the state is a null pointer");
  return *static_cast<SavedState*>(state);
}

/// Takes the state of an instance, into an earlier state if there is one.
inline void get_state(const Instance& instance, void** state) {
  if (state == nullptr) throw std::invalid_argument("an argument is a null pointer");
  std::unique_ptr<SavedState> taken = instance.snapshot();
  if (*state != nullptr) return state_of(*state).assign(*taken);
  *state = taken.release();
}

inline void free_state(void** state) {
  if (state == nullptr) return;
  delete static_cast<SavedState*>(*state);
  *state = nullptr;
}

inline void write_state(const Instance& instance, void* state, void* bytes, std::size_t size) {
  const std::vector<std::uint8_t> serialized = instance.serialize(state_of(state));
  if (bytes == nullptr || size < serialized.size()) {
    throw std::invalid_argument("the buffer is a null pointer or too small for the state");
  }
  std::memcpy(bytes, serialized.data(), serialized.size());
}

inline void read_state(const Instance& instance, const void* bytes, std::size_t size, void** state) {
  if (state == nullptr) throw std::invalid_argument("an argument is a null pointer");
  *state = instance.deserialize(static_cast<const std::uint8_t*>(bytes), size).release();
}

inline void require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(message);
}

}  // namespace robotcell::fmi
