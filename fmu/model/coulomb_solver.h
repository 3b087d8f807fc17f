// Contact impulses with Coulomb's friction cone, the same in every direction.
#pragma once

#include <dart/constraint/DantzigBoxedLcpSolver.hpp>
#include <string>

#include "fmu/model/coulomb_problem.h"

namespace robotcell {

/// Dantzig's method is exact, but only for a pyramid instead of the cone (41 % too strong along its edges),
/// and it takes the height of the pyramid from a solution without friction. Where its answer already
/// satisfies the cone it stands; otherwise the cone's own conditions are solved from there on. Holds no
/// memory: the same contacts give the same impulses.
class CoulombSolver : public dart::constraint::DantzigBoxedLcpSolver {
 public:
  const std::string& getType() const override;

  bool solve(int n, double* A, double* x, double* b, int nub, double* lo, double* hi, int* findex,
             bool earlyTermination) override;

  /// The engine's class has this function only where assertions are on, and its library, as distributed, was
  /// built with them: a table of virtual functions without the entry would be too short for it.
  virtual bool canSolve(int n, const double* A);

 private:
  CoulombProblem problem_;
};

}  // namespace robotcell
