#include "fmu/model/world/coulomb_problem.h"

#include <algorithm>
#include <cmath>

namespace robotcell {
namespace {

constexpr int kMaxSweeps = 400;
constexpr double kConvergenceTolerance = 1e-10;  // change in one sweep relative to the largest impulse

/// Stride of the rows of the engine's matrix: they are padded to a multiple of four numbers.
Eigen::Index row_stride(int n) { return n > 1 ? ((n - 1) | 3) + 1 : n; }

/// Lower bound of the diagonal, for bodies pressed between immovable ones.
constexpr double kMinInverseMass = 1e-12;

}  // namespace

void CoulombProblem::set(int n, const double* a, const double* b, const double* lo, const double* hi,
                         const int* findex) {
  using Padded = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  delassus_ = Eigen::Map<const Padded, 0, Eigen::OuterStride<>>(a, n, n, Eigen::OuterStride<>(row_stride(n)));
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
    const Eigen::Matrix2d block = delassus_.block<2, 2>(i + 1, i + 1);
    const double mean = block.trace() / 2;
    const double spread = std::hypot((block(0, 0) - block(1, 1)) / 2, (block(0, 1) + block(1, 0)) / 2);
    contacts_.push_back({i, hi[i + 1], std::max(mean + spread, kMinInverseMass)});
    i += 3;
  }
}

double CoulombProblem::inverse_mass(Eigen::Index row) const {
  return std::max(delassus_(row, row), kMinInverseMass);
}

double CoulombProblem::normal_update(const Contact& contact, const Eigen::VectorXd& x) const {
  const Eigen::Index row = contact.row;
  return std::max(0.0, x[row] - residual(row, x) / inverse_mass(row));
}

Eigen::Vector2d CoulombProblem::friction_update(const Contact& contact, const Eigen::VectorXd& x) const {
  const Eigen::Index row = contact.row + 1;
  const Eigen::Vector2d slip(residual(row, x), residual(row + 1, x));
  const Eigen::Vector2d unprojected = x.segment<2>(row) - slip / contact.largest_eigenvalue;
  const double limit = contact.friction * x[contact.row];
  const double size = unprojected.norm();
  return size > limit ? Eigen::Vector2d(unprojected * (limit / size)) : unprojected;
}

double CoulombProblem::bounded_update(const Bounded& bounded, const Eigen::VectorXd& x) const {
  const double unprojected = x[bounded.row] - residual(bounded.row, x) / inverse_mass(bounded.row);
  return std::min(std::max(unprojected, bounded.lo), bounded.hi);
}

double CoulombProblem::violation(const Eigen::VectorXd& x) const {
  double largest = 0;
  for (const Contact& contact : contacts_) {
    largest = std::max(largest, std::abs(normal_update(contact, x) - x[contact.row]));
    largest = std::max(largest, (friction_update(contact, x) - x.segment<2>(contact.row + 1)).norm());
  }
  for (const Bounded& bounded : bounded_) {
    largest = std::max(largest, std::abs(bounded_update(bounded, x) - x[bounded.row]));
  }
  return largest;
}

bool CoulombProblem::run_gauss_seidel(Eigen::VectorXd& x) const {
  for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
    const Eigen::VectorXd before = x;
    for (const Bounded& bounded : bounded_) x[bounded.row] = bounded_update(bounded, x);
    for (const Contact& contact : contacts_) {
      x[contact.row] = normal_update(contact, x);
      x.segment<2>(contact.row + 1) = friction_update(contact, x);
    }
    if ((x - before).cwiseAbs().maxCoeff() <= kConvergenceTolerance * x.cwiseAbs().maxCoeff()) return true;
  }
  return false;
}

}  // namespace robotcell
