// The stick anchor restores what is in the plane of the support and nothing else.
#include <gtest/gtest.h>

#include "fmu/model/stick_anchor.h"

namespace {

using Eigen::AngleAxisd;
using Eigen::Isometry3d;
using Eigen::Translation3d;
using Eigen::Vector3d;
using robotcell::ContactForce;
using robotcell::StickAnchor;

constexpr double kFriction = 0.5;

ContactForce force(double normal, double tangential) { return {normal, Vector3d(0.6, 0.8, 0) * tangential}; }

Isometry3d placed(double x, double y, double z, double turn, double tilt) {
  return Translation3d(x, y, z) * AngleAxisd(turn, Vector3d::UnitZ()) * AngleAxisd(tilt, Vector3d::UnitX());
}

TEST(StickAnchor, RestoresPositionAndTurnButNotHeightAndTilt) {
  StickAnchor anchor(kFriction);
  anchor.settle(placed(0.1, 0.2, 0, 0.7, 0), force(10, 1));
  const Isometry3d restored = anchor.settle(placed(0.1003, 0.1998, 0.001, 0.705, 1e-4), force(10, 4.8));
  EXPECT_TRUE(restored.isApprox(placed(0.1, 0.2, 0.001, 0.7, 1e-4), 1e-7)) << restored.matrix();
}

TEST(StickAnchor, LetsGoAtTheCoulombLimitInAnyDirection) {
  for (const double angle : {0.0, 0.4, 0.785, 1.2}) {
    const Vector3d direction(std::cos(angle), std::sin(angle), 0);
    StickAnchor anchor(kFriction);
    const Isometry3d rest = placed(0.1, 0, 0, 0, 0);
    const Isometry3d moved = placed(0.2, 0, 0, 0, 0);
    anchor.settle(rest, {10, direction});
    EXPECT_TRUE(anchor.settle(moved, {10, direction * 4.85}).isApprox(rest));
    EXPECT_TRUE(anchor.settle(moved, {10, direction * 4.95}).isApprox(moved));
    EXPECT_TRUE(anchor.settle(moved, {10, direction}).isApprox(moved));  // holds anew where it came to rest
  }
}

TEST(StickAnchor, HoldsNothingThatDoesNotTouch) {
  StickAnchor anchor(kFriction);
  anchor.settle(placed(0, 0, 0, 0, 0), force(10, 0));
  const Isometry3d lifted = placed(0.3, 0, 0.1, 0, 0);
  EXPECT_TRUE(anchor.settle(lifted, force(0, 0)).isApprox(lifted));
  EXPECT_FALSE(anchor.state().engaged);
}

}  // namespace
