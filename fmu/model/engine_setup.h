// What the dynamics engine needs before a world can be made or stepped.
#pragma once

#include <dart/constraint/ConstraintSolver.hpp>
#include <memory>

#include "fmu/model/contact_description.h"

namespace robotcell {

/// Opens the collision library for as long as this library is loaded, and for this thread. Takes no lock.
void prepare_engine();

/// ODE keeps collision caches per thread; an importer may step an instance from any thread.
void prepare_thread();

/// Where Dantzig's method gives up, Gauss-Seidel's takes its place.
std::unique_ptr<dart::constraint::ConstraintSolver> make_solver(const ContactDescription& contact);

}  // namespace robotcell
