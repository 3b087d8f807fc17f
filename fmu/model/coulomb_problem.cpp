#include "fmu/model/coulomb_problem.h"

#include <algorithm>
#include <cmath>

namespace robotcell {
namespace {

constexpr int kMostSweeps = 400;
constexpr double kConverged = 1e-10;  // change in a sweep relative to the largest impulse

/// Distance between two rows of the engine's matrix: rows are padded to a multiple of four numbers.
Eigen::Index row_stride(int n) { return n > 1 ? ((n - 1) | 3) + 1 : n; }

/// Rows that nothing can accelerate, of a body pressed between immovable ones, still need a positive
/// diagonal.
constexpr double kLeastMassInverse = 1e-12;

}  // namespace

void CoulombProblem::set(int n, const double* a, const double* b, const double* lo, const double* hi,
                         const int* findex) {
  using Padded = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  a_ = Eigen::Map<const Padded, 0, Eigen::OuterStride<>>(a, n, n, Eigen::OuterStride<>(row_stride(n)));
  b_ = Eigen::Map<const Eigen::VectorXd>(b, n);
  contacts_.clear();
  bounded_.clear();
  for (Eigen::Index i = 0; i < n;) {
    const bool contact = i + 2 < n && findex[i + 1] == i && findex[i + 2] == i;
    if (!contact) {
      bounded_.push_back({i, lo[i], hi[i]});
      ++i;
      continue;
    }
    const Eigen::Matrix2d block = a_.block<2, 2>(i + 1, i + 1);
    const double mean = block.trace() / 2;
    const double spread = std::hypot((block(0, 0) - block(1, 1)) / 2, (block(0, 1) + block(1, 0)) / 2);
    contacts_.push_back({i, hi[i + 1], std::max(mean + spread, kLeastMassInverse)});
    i += 3;
  }
}

double CoulombProblem::mass_inverse(Eigen::Index row) const {
  return std::max(a_(row, row), kLeastMassInverse);
}

double CoulombProblem::normal_update(const Contact& contact, const Eigen::VectorXd& x) const {
  const Eigen::Index row = contact.row;
  return std::max(0.0, x[row] - excess(row, x) / mass_inverse(row));
}

Eigen::Vector2d CoulombProblem::friction_update(const Contact& contact, const Eigen::VectorXd& x) const {
  const Eigen::Index row = contact.row + 1;
  const Eigen::Vector2d slip(excess(row, x), excess(row + 1, x));
  const Eigen::Vector2d wanted = x.segment<2>(row) - slip / contact.stiffest;
  const double limit = contact.friction * x[contact.row];
  const double size = wanted.norm();
  return size > limit ? Eigen::Vector2d(wanted * (limit / size)) : wanted;
}

double CoulombProblem::bounded_update(const Bounded& bounded, const Eigen::VectorXd& x) const {
  const double wanted = x[bounded.row] - excess(bounded.row, x) / mass_inverse(bounded.row);
  return std::min(std::max(wanted, bounded.lo), bounded.hi);
}

double CoulombProblem::violation(const Eigen::VectorXd& x) const {
  double worst = 0;
  for (const Contact& contact : contacts_) {
    worst = std::max(worst, std::abs(normal_update(contact, x) - x[contact.row]));
    worst = std::max(worst, (friction_update(contact, x) - x.segment<2>(contact.row + 1)).norm());
  }
  for (const Bounded& bounded : bounded_) {
    worst = std::max(worst, std::abs(bounded_update(bounded, x) - x[bounded.row]));
  }
  return worst;
}

void CoulombProblem::improve(Eigen::VectorXd& x) const {
  for (int sweep = 0; sweep < kMostSweeps; ++sweep) {
    const Eigen::VectorXd before = x;
    for (const Bounded& bounded : bounded_) x[bounded.row] = bounded_update(bounded, x);
    for (const Contact& contact : contacts_) {
      x[contact.row] = normal_update(contact, x);
      x.segment<2>(contact.row + 1) = friction_update(contact, x);
    }
    if ((x - before).cwiseAbs().maxCoeff() <= kConverged * x.cwiseAbs().maxCoeff()) return;
  }
}

}  // namespace robotcell
