#include "fmu/model/world/coulomb_solver.h"

namespace robotcell {
namespace {

/// Violation of the cone, relative to the largest impulse, up to which a result is a solution.
constexpr double kTolerance = 1e-6;

}  // namespace

const std::string& CoulombSolver::getType() const {
  static const std::string type = "CoulombSolver";
  return type;
}

bool CoulombSolver::canSolve(int /*n*/, const double* /*A*/) { return true; }

bool CoulombSolver::solve(int n, double* A, double* x, double* b, int nub, double* lo, double* hi,
                          int* findex, bool earlyTermination) {
  problem_.set(n, A, b, lo, hi, findex);  // copied first: Dantzig's method works in place
  if (!DantzigBoxedLcpSolver::solve(n, A, x, b, nub, lo, hi, findex, earlyTermination)) return false;
  Eigen::VectorXd impulses = Eigen::Map<Eigen::VectorXd>(x, n);
  if (!impulses.allFinite()) return true;  // the engine detects it and uses its secondary solver
  const auto solved = [&] {
    return problem_.violation(impulses) <= kTolerance * impulses.cwiseAbs().maxCoeff();
  };
  if (solved()) return true;
  if (!problem_.run_gauss_seidel(impulses) && !solved()) ++*fallbacks_;
  Eigen::Map<Eigen::VectorXd>(x, n) = impulses;
  return true;
}

bool GaussSeidelSolver::solve(int n, double* A, double* x, double* b, int nub, double* lo, double* hi,
                              int* findex, bool earlyTermination) {
  const bool solved = PgsBoxedLcpSolver::solve(n, A, x, b, nub, lo, hi, findex, earlyTermination);
  if (!solved) ++*fallbacks_;
  return solved;
}

bool FallbackSolver::solve(int n, double* A, double* x, double* b, int nub, double* lo, double* hi,
                           int* findex, bool earlyTermination) {
  ++*fallbacks_;
  return PgsBoxedLcpSolver::solve(n, A, x, b, nub, lo, hi, findex, earlyTermination);
}

}  // namespace robotcell
