// Initialisation of the dynamics engine and its collision library.
#pragma once

#include <dart/constraint/ConstraintSolver.hpp>
#include <memory>

#include "fmu/model/description/contact_description.h"
#include "fmu/model/world/coulomb_solver.h"

namespace robotcell {

/// Initialises ODE for the lifetime of this library, and for this thread. Takes no lock.
void prepare_engine();

/// Initialises ODE's per-thread collision caches; an importer may step an instance from any thread.
void prepare_thread();

/// Creates the contact solver. Projected Gauss-Seidel is the fallback where Dantzig's method fails;
/// `fallbacks` counts these, and sweeps that do not converge, with either solver.
std::unique_ptr<dart::constraint::ConstraintSolver> make_solver(const ContactDescription& contact,
                                                                const FallbackCount& fallbacks);

}  // namespace robotcell
