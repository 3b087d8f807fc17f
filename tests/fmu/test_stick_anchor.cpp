// The stick anchor restores what is in the plane of the support and nothing else.
#include <gtest/gtest.h>

#include "fmu/model/stick_anchor.h"

namespace {

using Eigen::AngleAxisd;
using Eigen::Isometry3d;
using Eigen::Translation3d;
using Eigen::Vector3d;
using namespace robotcell;

constexpr double kFriction = 0.5;

Isometry3d placed(double x, double y, double z, double turn, double tilt) {
  return Translation3d(x, y, z) * AngleAxisd(turn, Vector3d::UnitZ()) * AngleAxisd(tilt, Vector3d::UnitX());
}

TEST(StickAnchor, RestoresPositionAndTurnButNotHeightAndTilt) {
  const StickAnchor anchor{0, Vector3d::UnitZ(), placed(0.1, 0.2, 0, 0.7, 0)};
  const Isometry3d held = held_pose(anchor, placed(0.1003, 0.1998, 0.001, 0.705, 1e-4));
  EXPECT_TRUE(held.isApprox(placed(0.1, 0.2, 0.001, 0.7, 1e-4), 1e-7)) << held.matrix();
}

TEST(StickAnchor, HoldsInAnyPlaneAlike) {
  // The same displacement, seen in a support whose z axis is not the normal.
  const Isometry3d turned(AngleAxisd(0.8, Vector3d(1, 2, -1).normalized()));
  const Isometry3d rest = placed(0.1, 0.2, 0, 0.7, 0);
  const Isometry3d moved = placed(0.1003, 0.1998, 0.001, 0.705, 1e-4);
  const StickAnchor flat{0, Vector3d::UnitZ(), rest};
  const StickAnchor inclined{0, turned.linear() * Vector3d::UnitZ(), turned * rest};
  EXPECT_TRUE(held_pose(inclined, turned * moved).isApprox(turned * held_pose(flat, moved), 1e-12));
}

TEST(StickAnchor, LetsGoAtTheCoulombLimitInAnyDirection) {
  for (const double angle : {0.0, 0.4, 0.785, 1.2}) {
    const Vector3d direction(std::cos(angle), std::sin(angle), 0);
    EXPECT_TRUE(friction_holds({10, direction * 4.97}, kFriction));
    EXPECT_FALSE(friction_holds({10, direction * 4.98}, kFriction));
  }
}

TEST(StickAnchor, HoldsNothingThatDoesNotTouch) {
  EXPECT_FALSE(friction_holds({0, Vector3d::Zero()}, kFriction));
}

TEST(StickAnchor, ForcesAreSplitAtThePlaneOfContact) {
  const Vector3d normal(0.6, 0, 0.8);
  const ContactForce force = split(Vector3d(1, 2, 3), normal);
  EXPECT_DOUBLE_EQ(force.normal, 3);
  EXPECT_NEAR(force.tangential.dot(normal), 0, 1e-15);
  EXPECT_TRUE((force.normal * normal + force.tangential).isApprox(Vector3d(1, 2, 3)));
}

}  // namespace
