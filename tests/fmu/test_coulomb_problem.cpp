// Impulses of a single contact against closed forms.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include "fmu/model/world/coulomb_problem.h"
#include "fmu/model/world/coulomb_solver.h"

namespace {

using robotcell::CoulombProblem;
using robotcell::CoulombSolver;
using robotcell::FallbackSolver;
using robotcell::GaussSeidelSolver;

constexpr double kProblemFriction = 0.3;

/// One contact of a point mass of 2 kg with an approach velocity.
CoulombProblem point_mass(double approach, double slip_x, double slip_y) {
  std::array<double, 12> a{};
  for (std::size_t i = 0; i < 3; ++i) a[4 * i + i] = 0.5;
  const std::array<double, 3> b{approach, -slip_x, -slip_y};
  const std::array<double, 3> lo{0, -kProblemFriction, -kProblemFriction};
  const std::array<double, 3> hi{HUGE_VAL, kProblemFriction, kProblemFriction};
  const std::array<int, 3> normals{-1, 0, 0};
  CoulombProblem problem;
  problem.set(3, a.data(), b.data(), lo.data(), hi.data(), normals.data());
  return problem;
}

Eigen::VectorXd solved(const CoulombProblem& problem) {
  Eigen::VectorXd x = Eigen::VectorXd::Zero(3);
  EXPECT_TRUE(problem.run_gauss_seidel(x));
  EXPECT_LT(problem.violation(x), 1e-9);
  return x;
}

TEST(CoulombProblem, SlowSlipIsStopped) {
  EXPECT_TRUE(solved(point_mass(1, 0.1, -0.2)).isApprox(Eigen::Vector3d(2, -0.2, 0.4), 1e-9));
}

TEST(CoulombProblem, FastSlipIsOpposedByFullFriction) {
  for (const double angle : {0.0, 0.3, 0.8, 2.5, 4.0}) {
    const Eigen::VectorXd x = solved(point_mass(1, std::cos(angle), std::sin(angle)));
    EXPECT_NEAR(x[1], -2 * kProblemFriction * std::cos(angle), 1e-9);
    EXPECT_NEAR(x[2], -2 * kProblemFriction * std::sin(angle), 1e-9);
  }
}

TEST(CoulombProblem, SeparatingContactHasNoImpulse) {
  EXPECT_TRUE(solved(point_mass(-1, 0.1, 0.1)).isZero());
}

TEST(CoulombProblem, CornerOfPyramidViolatesCone) {
  const CoulombProblem problem = point_mass(1, 1, 1);
  EXPECT_GT(problem.violation(Eigen::Vector3d(2, -2 * kProblemFriction, -2 * kProblemFriction)), 0.1);
}

/// A column of point masses pressed together, whose lowest one slips along a diagonal: the sweeps carry an
/// impulse from contact to contact and do not converge.
struct Column {
  static constexpr int kContacts = 60, kRows = 3 * kContacts;
  static constexpr int kStride = ((kRows - 1) | 3) + 1;

  Column() : a(kRows * kStride), b(kRows, 1), lo(kRows, 0), hi(kRows, HUGE_VAL), findex(kRows, -1) {
    for (int i = 0; i < kContacts; ++i) {
      for (int axis = 0; axis < 3; ++axis) {
        const int row = 3 * i + axis;
        at(row, row) = i == 0 ? 1 : 2;
        if (i > 0) at(row, row - 3) = at(row - 3, row) = -1;
        if (axis == 0) continue;
        b[static_cast<std::size_t>(row)] = i == 0 ? -1e5 : 0;
        lo[static_cast<std::size_t>(row)] = -kProblemFriction;
        hi[static_cast<std::size_t>(row)] = kProblemFriction;
        findex[static_cast<std::size_t>(row)] = 3 * i;
      }
    }
  }

  double& at(int row, int column) { return a[static_cast<std::size_t>(row * kStride + column)]; }

  std::vector<double> a, b, lo, hi;
  std::vector<int> findex;
};

TEST(CoulombProblem, TellsThatSweepsDidNotConverge) {
  Column column;
  CoulombProblem problem;
  problem.set(Column::kRows, column.a.data(), column.b.data(), column.lo.data(), column.hi.data(),
              column.findex.data());
  Eigen::VectorXd x = Eigen::VectorXd::Zero(Column::kRows);
  EXPECT_FALSE(problem.run_gauss_seidel(x));
}

TEST(SolverFallbacks, AreCounted) {
  const auto count = std::make_shared<std::int32_t>(0);
  const auto solve = [](dart::constraint::BoxedLcpSolver& solver) {
    Column column;
    std::vector<double> x(Column::kRows, 0);
    solver.solve(Column::kRows, column.a.data(), x.data(), column.b.data(), 0, column.lo.data(),
                 column.hi.data(), column.findex.data(), true);
  };
  CoulombSolver cone(count);
  solve(cone);
  EXPECT_EQ(*count, 1);
  FallbackSolver fallback(count);
  solve(fallback);
  EXPECT_EQ(*count, 2);
  GaussSeidelSolver primary(count);
  solve(primary);
  EXPECT_EQ(*count, 3);
}

}  // namespace
