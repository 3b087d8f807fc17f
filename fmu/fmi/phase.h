// Phases of an instance between instantiation and termination.
#pragma once

#include <cstdint>
#include <string>

namespace robotcell::fmi {

enum class Phase : std::int32_t {
  kInstantiated,
  kInitialization,
  kStepping,
  kTerminated,
  kFailed,
  kEvent,         // FMI 3 with event mode
  kIntermediate,  // FMI 3, during an intermediate update; never part of a state
};

/// Throws std::logic_error: `what` is not allowed in this phase.
[[noreturn]] void reject_call(const std::string& what, Phase phase);

}  // namespace robotcell::fmi
