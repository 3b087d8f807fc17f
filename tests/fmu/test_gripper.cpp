// Gripper against closed forms: width, force, slip in any direction, centring.
#include "fmu/model/world/gripper_body.h"

#include <gtest/gtest.h>

#include <cmath>
#include <dart/constraint/PgsBoxedLcpSolver.hpp>

#include "tests/fmu/gripper_world.h"

namespace {

using namespace robotcell;
using namespace robotcell::testing;

constexpr double kForce = 20;
constexpr double kLimit =
    2 * kPadFriction * kForce / kPartMass;  // m/s^2, maximum acceleration of the part by friction of two pads

TEST(Gripper, OpensToWidthAtMaximumSpeed) {
  GripperWorld cell;
  cell.gripper->command({static_cast<std::int32_t>(GripperMode::kWidth), 0.08, 0});
  cell.run(50);  // 5 mm for each finger
  EXPECT_NEAR(cell.gripper->width(), 0.07, 1e-6);
  cell.run(100);
  EXPECT_NEAR(cell.gripper->width(), 0.08, 1e-6);
}

TEST(Gripper, ClosedEmptyGripperIsNotGripping) {
  GripperWorld cell(std::make_shared<CoulombSolver>(), a_gripper(), kPartSize, {0, 0, 1});
  cell.grip(kForce);
  EXPECT_NEAR(cell.gripper->width(), 0, 1e-6);
  EXPECT_FALSE(cell.gripper->is_gripping());
}

TEST(Gripper, PressesWithCommandedForce) {
  GripperWorld cell;
  EXPECT_FALSE(cell.gripper->is_gripping());
  for (const double force : {5.0, 20.0, 60.0}) {
    cell.grip(force);
    EXPECT_TRUE(cell.gripper->is_gripping());
    EXPECT_NEAR(cell.gripper->force(), force, 1e-6);
    EXPECT_NEAR(cell.gripper->width(), kPartSize.x(), 2e-5);
    EXPECT_NEAR(cell.body()->getConstraintImpulse().norm(), 0, 1e-6);
  }
  cell.grip(1000);
  EXPECT_NEAR(cell.gripper->force(), a_gripper().max_force, 1e-6);
}

TEST(Gripper, CentresPartAndDeflectsUnderWeightByCentringStiffness) {
  GripperWorld cell(std::make_shared<CoulombSolver>(), a_gripper(), kPartSize, {0.004, 0, 0.04});
  cell.grip(kForce);
  EXPECT_NEAR(cell.part_in_gripper().x(), 0,
              5e-6);  // the penetration depths of the pads differ by micrometres
  cell.world->setGravity({-kGravity, 0, 0});
  cell.run(400);
  const double weight = (kPartMass + 2 * a_gripper().finger_mass) * kGravity;
  const double sag = weight / (4 * a_gripper().centring_stiffness);
  EXPECT_NEAR(cell.part_in_gripper().x(), -sag, 0.02 * sag);
}

class Grasp : public ::testing::TestWithParam<int> {
 protected:
  Vector3d direction() const {
    const double angle = GetParam() * M_PI / 180;
    return {0, std::cos(angle), std::sin(angle)};
  }
};

TEST_P(Grasp, SticksBelowCoulombLimit) {
  GripperWorld cell;
  cell.grip(kForce);
  const Vector3d before = cell.part_in_gripper();
  cell.run(100, 0.98 * kLimit * direction());
  EXPECT_LT((cell.part_in_gripper() - before).norm(), 2e-6);
}

TEST_P(Grasp, SlipsAboveLimitWithExcessForce) {
  GripperWorld cell;
  cell.grip(kForce);
  cell.run(30, 1.02 * kLimit * direction());
  const double expected = 0.02 * kLimit * 30 * kStep;
  EXPECT_NEAR(-cell.slip_speed().dot(direction()), expected, 0.05 * expected);
}

INSTANTIATE_TEST_SUITE_P(Directions, Grasp, ::testing::Values(0, 15, 30, 45, 60, 90, 120, 225, 315));

/// Rotation in the grasp of a bar held 50 mm from its centre of mass, with its weight across the pads.
double turn_of_a_bar(const dart::constraint::BoxedLcpSolverPtr& solver, std::size_t contacts) {
  GripperWorld cell(solver, a_gripper(), {0.03, 0.03, 0.16}, {0, 0, 0.08});
  cell.set_max_contacts(contacts);
  cell.grip(40);
  const Isometry3d before = cell.flange_from_part();
  cell.world->setGravity({0, -kGravity, 0});
  cell.run(600);
  return Eigen::AngleAxisd((before.inverse() * cell.flange_from_part()).linear()).angle();
}

TEST(ContactPoints, FourPerPadHoldBarAgainstMoment) {
  EXPECT_LT(turn_of_a_bar(std::make_shared<CoulombSolver>(), 4), 2e-6);
}

TEST(ContactPoints, OnePerPadLetsBarRotateAboutLineThroughThem) {
  EXPECT_GT(turn_of_a_bar(std::make_shared<CoulombSolver>(), 1), 0.2);
}

/// Projected Gauss-Seidel stops before convergence.
TEST(GaussSeidel, LetsBarCreepThatDantzigHolds) {
  const double exact = turn_of_a_bar(std::make_shared<CoulombSolver>(), 4);
  EXPECT_GT(turn_of_a_bar(std::make_shared<dart::constraint::PgsBoxedLcpSolver>(), 4), 10 * exact);
}

double fall_of_a_stack(const dart::constraint::BoxedLcpSolverPtr& solver) {
  const auto world = make_world(solver);
  add_floor(world, 0.5);
  SkeletonPtr top;
  const double edge = 0.05;
  for (int i = 0; i < 6; ++i) {
    const Isometry3d pose(Eigen::Translation3d(0.002 * (i % 2), 0, (i + 0.5) * edge));
    top = add_free_box(world, "box" + std::to_string(i), {edge, edge, edge}, 0.2 * (i + 1), 0.5, pose);
  }
  const double before = top->getBodyNode(0)->getWorldTransform().translation().z();
  for (int i = 0; i < 2000; ++i) world->step();
  return before - top->getBodyNode(0)->getWorldTransform().translation().z();
}

TEST(StackOfBoxes, StandsWithDantzigAndFallsWithGaussSeidel) {
  EXPECT_LT(fall_of_a_stack(std::make_shared<CoulombSolver>()), 5e-6);
  EXPECT_GT(fall_of_a_stack(std::make_shared<dart::constraint::PgsBoxedLcpSolver>()), 0.05);
}

}  // namespace
