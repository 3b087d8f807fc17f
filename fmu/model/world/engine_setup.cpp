#include "fmu/model/world/engine_setup.h"

#include <ode/odeinit.h>

#include <dart/constraint/BoxedLcpConstraintSolver.hpp>
#include <dart/constraint/PgsBoxedLcpSolver.hpp>

namespace robotcell {
namespace {

/// ODE stays initialised while the library is loaded, independent of the number of worlds.
struct OdeLibrary {
  OdeLibrary() { dInitODE2(0); }
  ~OdeLibrary() { dCloseODE(); }
};

}  // namespace

void prepare_engine() {
  static const OdeLibrary ode_library;
  prepare_thread();
}

void prepare_thread() {
  thread_local const int prepared = dAllocateODEDataForThread(dAllocateMaskAll);
  static_cast<void>(prepared);
}

std::unique_ptr<dart::constraint::ConstraintSolver> make_solver(const ContactDescription& contact,
                                                                const FallbackCount& fallbacks) {
  using namespace dart::constraint;
  if (contact.gauss_seidel) {
    return std::make_unique<BoxedLcpConstraintSolver>(std::make_shared<GaussSeidelSolver>(fallbacks),
                                                      nullptr);
  }
  return std::make_unique<BoxedLcpConstraintSolver>(std::make_shared<CoulombSolver>(fallbacks),
                                                    std::make_shared<FallbackSolver>(fallbacks));
}

}  // namespace robotcell
