// The stick constraint projects only in the contact plane, and holds exactly where friction does.
#include <gtest/gtest.h>

#include "fmu/model/description/cell_description.h"
#include "fmu/model/world/stick_constraint.h"
#include "fmu/model/world/world.h"

namespace {

using Eigen::AngleAxisd;
using Eigen::Isometry3d;
using Eigen::Translation3d;
using Eigen::Vector3d;
using namespace robotcell;

constexpr double kFriction = 0.5;

Isometry3d placed(double x, double y, double z, double twist, double tilt) {
  return Translation3d(x, y, z) * AngleAxisd(twist, Vector3d::UnitZ()) * AngleAxisd(tilt, Vector3d::UnitX());
}

TEST(StickConstraint, ProjectsPositionAndTwistButNotHeightAndTilt) {
  const StickConstraint constraint{0, Vector3d::UnitZ(), placed(0.1, 0.2, 0, 0.7, 0)};
  const Isometry3d projected = project_pose(constraint, placed(0.1003, 0.1998, 0.001, 0.705, 1e-4));
  EXPECT_TRUE(projected.isApprox(placed(0.1, 0.2, 0.001, 0.7, 1e-4), 1e-7)) << projected.matrix();
}

TEST(StickConstraint, HoldsInAnyContactPlane) {
  // The same displacement in a support frame whose z axis is not the normal.
  const Isometry3d turned(AngleAxisd(0.8, Vector3d(1, 2, -1).normalized()));
  const Isometry3d rest = placed(0.1, 0.2, 0, 0.7, 0);
  const Isometry3d moved = placed(0.1003, 0.1998, 0.001, 0.705, 1e-4);
  const StickConstraint flat{0, Vector3d::UnitZ(), rest};
  const StickConstraint inclined{0, turned.linear() * Vector3d::UnitZ(), turned * rest};
  EXPECT_TRUE(project_pose(inclined, turned * moved).isApprox(turned * project_pose(flat, moved), 1e-12));
}

TEST(StickConstraint, ReleasesAtCoulombLimitInAnyDirection) {
  for (const double angle : {0.0, 0.4, 0.785, 1.2}) {
    const Vector3d direction(std::cos(angle), std::sin(angle), 0);
    EXPECT_TRUE(within_friction_cone({10, direction * 4.97}, kFriction));
    EXPECT_FALSE(within_friction_cone({10, direction * 4.98}, kFriction));
  }
}

TEST(StickConstraint, NoContactIsOutsideFrictionCone) {
  EXPECT_FALSE(within_friction_cone({0, Vector3d::Zero()}, kFriction));
}

TEST(StickConstraint, ForcesAreSplitAtContactPlane) {
  const Vector3d normal(0.6, 0, 0.8);
  const ContactForce force = split(Vector3d(1, 2, 3), normal);
  EXPECT_DOUBLE_EQ(force.normal, 3);
  EXPECT_NEAR(force.tangential.dot(normal), 0, 1e-15);
  EXPECT_TRUE((force.normal * normal + force.tangential).isApprox(Vector3d(1, 2, 3)));
}

TEST(StickConstraint, TorsionAloneAndForceAloneReleaseAtTheirLimits) {
  EXPECT_TRUE(friction_holds({0, 0.99}));
  EXPECT_FALSE(friction_holds({0, 1}));
  EXPECT_TRUE(friction_holds({0.99, 0}));
  EXPECT_FALSE(friction_holds({1, 0}));
  EXPECT_FALSE(friction_holds({0.9, 0.9}));
}

/// A box of 0.06 x 0.04 x 0.05 m on the rotary table.
struct OnTable {
  explicit OnTable(double radius, double friction, bool stick)
      : cell(parse_cell(read_text_file(SCANCELL_TEST_CELLS "/free/cell.json"))) {
    cell.parts[0].support_from_part = Translation3d(radius, 0, 0) * Eigen::Quaterniond::Identity();
    cell.parts[0].friction = friction;
    cell.contact.stick = stick;
    for (std::size_t i = 0; i < cell.joints.size(); ++i) motion.axes.position[i] = cell.joints[i].start;
    world = std::make_unique<World>(cell, Kinematics(cell, AsBuilt{}), motion);
  }

  /// Rotates the table with constant angular acceleration for some steps.
  void run(int steps, double acceleration) {
    for (int i = 0; i < steps; ++i) {
      const PrescribedMotion before = motion;
      double& rate = motion.axes.rate[kTableAxis];
      motion.axes.position[kTableAxis] += (rate + acceleration * kStep / 2) * kStep;
      rate += acceleration * kStep;
      world->step(before, motion);
    }
  }

  Isometry3d on_platter() const { return world->placement(0).frame_from_part; }
  double angle() const {
    const Eigen::Matrix3d turn = on_platter().linear();
    return std::atan2(turn(1, 0), turn(0, 0));
  }

  static constexpr double kStep = 1e-3;
  CellDescription cell;
  PrescribedMotion motion;
  std::unique_ptr<World> world;
};

constexpr double kGravity = 9.80665;

class StickSwitch : public ::testing::TestWithParam<bool> {};

/// Pure torsion: a box on the axis of the table, which is accelerated. Friction on the four corners of its
/// base transmits the moment mu m g r.
TEST_P(StickSwitch, BoxOnAxisSlipsAtTorsionLimit) {
  constexpr double kLowFriction = 0.02;
  const double gyration_squared = (0.06 * 0.06 + 0.04 * 0.04) / 12;
  const double limit = kLowFriction * kGravity * std::hypot(0.03, 0.02) / gyration_squared;
  OnTable held(0, kLowFriction, GetParam());
  const double before = held.angle();
  held.run(100, 0.97 * limit);
  EXPECT_NEAR(held.angle(), before, 1e-6);
  for (const double excess : {0.03, 0.1}) {
    OnTable slipping(0, kLowFriction, GetParam());
    for (const int steps : {10, 25, 60}) {
      OnTable box(0, kLowFriction, GetParam());
      box.run(steps, (1 + excess) * limit);
      const double expected = excess * limit * std::pow(steps * OnTable::kStep, 2) / 2;
      EXPECT_NEAR(before - box.angle(), expected, 0.12 * expected) << steps;
    }
  }
}

/// Without the constraint a part on a rotating table leaves its circle along the tangent in every step: it
/// creeps outwards by (w h)^2 r / 2 per step of h.
TEST_P(StickSwitch, CreepOnRotatingTable) {
  constexpr double kRadius = 0.09, kRate = 2;
  OnTable box(kRadius, 0.5, GetParam());
  box.run(200, kRate / 0.2);
  const Vector3d before = box.on_platter().translation();
  constexpr int kSteps = 2000;
  box.run(kSteps, 0);
  const double creep = (box.on_platter().translation() - before).norm();
  const double expected = kSteps * std::pow(kRate * OnTable::kStep, 2) * kRadius / 2;
  if (GetParam()) {
    EXPECT_LT(creep, 1e-9);
  } else {
    EXPECT_NEAR(creep, expected, 0.03 * expected);
  }
}

INSTANTIATE_TEST_SUITE_P(OnAndOff, StickSwitch, ::testing::Bool());

}  // namespace
