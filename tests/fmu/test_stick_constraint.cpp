// The stick constraint projects only in the contact plane.
#include <gtest/gtest.h>

#include "fmu/model/stick_constraint.h"

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

}  // namespace
