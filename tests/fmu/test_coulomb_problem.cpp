// Impulses of a single contact against closed forms.
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "fmu/model/coulomb_problem.h"

namespace {

using robotcell::CoulombProblem;

constexpr double kFriction = 0.3;

/// One contact of a point mass of 2 kg with an approach velocity.
CoulombProblem point_mass(double approach, double slip_x, double slip_y) {
  std::array<double, 12> a{};
  for (std::size_t i = 0; i < 3; ++i) a[4 * i + i] = 0.5;
  const std::array<double, 3> b{approach, -slip_x, -slip_y};
  const std::array<double, 3> lo{0, -kFriction, -kFriction};
  const std::array<double, 3> hi{HUGE_VAL, kFriction, kFriction};
  const std::array<int, 3> normals{-1, 0, 0};
  CoulombProblem problem;
  problem.set(3, a.data(), b.data(), lo.data(), hi.data(), normals.data());
  return problem;
}

Eigen::VectorXd solved(const CoulombProblem& problem) {
  Eigen::VectorXd x = Eigen::VectorXd::Zero(3);
  problem.run_gauss_seidel(x);
  EXPECT_LT(problem.violation(x), 1e-9);
  return x;
}

TEST(CoulombProblem, SlowSlipIsStopped) {
  EXPECT_TRUE(solved(point_mass(1, 0.1, -0.2)).isApprox(Eigen::Vector3d(2, -0.2, 0.4), 1e-9));
}

TEST(CoulombProblem, FastSlipIsOpposedByFullFriction) {
  for (const double angle : {0.0, 0.3, 0.8, 2.5, 4.0}) {
    const Eigen::VectorXd x = solved(point_mass(1, std::cos(angle), std::sin(angle)));
    EXPECT_NEAR(x[1], -2 * kFriction * std::cos(angle), 1e-9);
    EXPECT_NEAR(x[2], -2 * kFriction * std::sin(angle), 1e-9);
  }
}

TEST(CoulombProblem, SeparatingContactHasNoImpulse) {
  EXPECT_TRUE(solved(point_mass(-1, 0.1, 0.1)).isZero());
}

TEST(CoulombProblem, CornerOfPyramidViolatesCone) {
  const CoulombProblem problem = point_mass(1, 1, 1);
  EXPECT_GT(problem.violation(Eigen::Vector3d(2, -2 * kFriction, -2 * kFriction)), 0.1);
}

}  // namespace
