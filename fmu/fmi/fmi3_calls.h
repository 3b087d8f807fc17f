// Helpers of the FMI 3.0 entry points.
#pragma once

#include "fmu/fmi/guard.h"

extern "C" {
#include "fmu/third_party/fmi/fmi3Functions.h"
}

namespace robotcell::fmi {

inline Instance* instance_of(fmi3Instance instance) { return static_cast<Instance*>(instance); }

/// Runs a call; an exception becomes an error message and status.
template <class Call>
fmi3Status status_of(fmi3Instance instance, const char* function, const Call& call) {
  return guarded(instance_of(instance), function, call) ? fmi3OK : fmi3Error;
}

}  // namespace robotcell::fmi
