#include "fmu/fmi/phase.h"

#include <stdexcept>

namespace robotcell::fmi {
namespace {

const char* phase_name(Phase phase) {
  switch (phase) {
    case Phase::kInstantiated:
      return "before initialization";
    case Phase::kInitialization:
      return "in initialization mode";
    case Phase::kStepping:
      return "while stepping";
    case Phase::kTerminated:
      return "after terminate";
    case Phase::kEvent:
      return "in event mode";
    case Phase::kIntermediate:
      return "during an intermediate update";
    default:
      return "after an error";
  }
}

}  // namespace

void reject_call(const std::string& what, Phase phase) {
  throw std::logic_error(what + " is not allowed " + phase_name(phase));
}

}  // namespace robotcell::fmi
