// Contact impulses with an isotropic Coulomb friction cone.
#pragma once

#include <dart/constraint/DantzigBoxedLcpSolver.hpp>
#include <dart/constraint/PgsBoxedLcpSolver.hpp>
#include <memory>
#include <string>

#include "fmu/model/world/coulomb_problem.h"

namespace robotcell {

/// Number of contact problems that were not solved as intended, shared by the solvers of a world.
using FallbackCount = std::shared_ptr<std::int32_t>;

/// Dantzig's method is exact, but for a friction pyramid (41 % too strong along its edges) whose height comes
/// from a solution without friction. Where its result satisfies the cone it is kept; otherwise it is the
/// start of Gauss-Seidel sweeps on the cone; sweeps that do not reach it are counted. There is no warm start:
/// the same contacts give the same impulses.
class CoulombSolver : public dart::constraint::DantzigBoxedLcpSolver {
 public:
  explicit CoulombSolver(FallbackCount fallbacks = std::make_shared<std::int32_t>(0))
      : fallbacks_(std::move(fallbacks)) {}

  const std::string& getType() const override;

  bool solve(int n, double* A, double* x, double* b, int nub, double* lo, double* hi, int* findex,
             bool earlyTermination) override;

  /// The base class has this function only where assertions are on, and DART as distributed was built with
  /// them: without this entry the virtual table would be too short for the library.
  virtual bool canSolve(int n, const double* A);

 private:
  CoulombProblem problem_;
  FallbackCount fallbacks_;
};

/// Projected Gauss-Seidel as the primary solver; problems on which it does not converge are counted.
class GaussSeidelSolver : public dart::constraint::PgsBoxedLcpSolver {
 public:
  explicit GaussSeidelSolver(FallbackCount fallbacks) : fallbacks_(std::move(fallbacks)) {}

  bool solve(int n, double* A, double* x, double* b, int nub, double* lo, double* hi, int* findex,
             bool earlyTermination) override;

 private:
  FallbackCount fallbacks_;
};

/// Projected Gauss-Seidel where the primary solver fails; each use is counted.
class FallbackSolver : public dart::constraint::PgsBoxedLcpSolver {
 public:
  explicit FallbackSolver(FallbackCount fallbacks) : fallbacks_(std::move(fallbacks)) {}

  bool solve(int n, double* A, double* x, double* b, int nub, double* lo, double* hi, int* findex,
             bool earlyTermination) override;

 private:
  FallbackCount fallbacks_;
};

}  // namespace robotcell
