#include "fmu/model/coulomb_solver.h"

namespace robotcell {
namespace {

/// Share of the largest impulse by which Dantzig's answer may break the cone's conditions and still stand.
constexpr double kGoodEnough = 1e-6;

}  // namespace

const std::string& CoulombSolver::getType() const {
  static const std::string type = "CoulombSolver";
  return type;
}

bool CoulombSolver::canSolve(int /*n*/, const double* /*A*/) { return true; }

bool CoulombSolver::solve(int n, double* A, double* x, double* b, int nub, double* lo, double* hi,
                          int* findex, bool earlyTermination) {
  problem_.set(n, A, b, lo, hi, findex);  // Dantzig's method works in place
  if (!DantzigBoxedLcpSolver::solve(n, A, x, b, nub, lo, hi, findex, earlyTermination)) return false;
  Eigen::VectorXd impulses = Eigen::Map<Eigen::VectorXd>(x, n);
  if (!impulses.allFinite()) return true;  // the engine sees it and takes its second solver
  if (problem_.violation(impulses) <= kGoodEnough * impulses.cwiseAbs().maxCoeff()) return true;
  problem_.improve(impulses);
  Eigen::Map<Eigen::VectorXd>(x, n) = impulses;
  return true;
}

}  // namespace robotcell
