// Where an instance is between being made and being freed.
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
  kEvent,         // FMI 3, where the importer uses event mode
  kIntermediate,  // FMI 3, while the importer is called from inside a step: never in a state
};

/// Throws std::logic_error: `what` is not allowed in this phase.
[[noreturn]] void refuse(const std::string& what, Phase phase);

}  // namespace robotcell::fmi
