// Coulomb friction in every direction: closed forms of a box on a floor.
#include <gtest/gtest.h>

#include <cmath>
#include <dart/constraint/DantzigBoxedLcpSolver.hpp>

#include "fmu/model/world/coulomb_solver.h"
#include "fmu/model/world/hull_shape.h"
#include "tests/fmu/engine_world.h"

namespace {

using namespace robotcell;
using namespace robotcell::testing;
using dart::constraint::BoxedLcpSolverPtr;

constexpr double kContactFriction = 0.5;
const Vector3d kSize(0.06, 0.06, 0.02);

struct OnFloor {
  explicit OnFloor(const BoxedLcpSolverPtr& solver = std::make_shared<CoulombSolver>())
      : world(make_world(solver)) {
    add_floor(world, 1.0);  // the smaller coefficient of a pair counts
    const Isometry3d pose(Eigen::Translation3d(0, 0, kSize.z() / 2));
    box = add_free_box(world, "box", kSize, 0.4, kContactFriction, pose);
    for (int i = 0; i < 50; ++i) world->step();
  }

  void run(int steps) {
    for (int i = 0; i < steps; ++i) world->step();
  }
  Vector3d velocity() const { return level(box->getBodyNode(0)->getLinearVelocity()); }
  Vector3d part_position() const { return level(box->getBodyNode(0)->getWorldTransform().translation()); }
  static Vector3d level(const Vector3d& v) { return {v.x(), v.y(), 0}; }

  dart::simulation::WorldPtr world;
  SkeletonPtr box;
};

Vector3d along(double angle) { return {std::cos(angle), std::sin(angle), 0}; }

/// Speed after 0.2 s under a pull of `share` times the friction limit.
Vector3d pulled(OnFloor& cell, double angle, double share) {
  const Vector3d down(0, 0, -kGravity);
  cell.world->setGravity(down + along(angle) * (share * kContactFriction * kGravity));
  cell.run(200);
  return cell.velocity();
}

class Friction : public ::testing::TestWithParam<int> {
 protected:
  double angle() const { return GetParam() * M_PI / 180; }
};

TEST_P(Friction, SticksBelowCoulombLimit) {
  OnFloor cell;
  const Vector3d before = cell.part_position();
  EXPECT_LT(pulled(cell, angle(), 0.995).norm(), 1e-6);
  EXPECT_LT((cell.part_position() - before).norm(), 1e-6);
}

TEST_P(Friction, SlipsAboveLimitWithExcessForceAlongPull) {
  OnFloor cell;
  const Vector3d velocity = pulled(cell, angle(), 1.02);
  const double expected = 0.02 * kContactFriction * kGravity * 0.2;
  EXPECT_NEAR(velocity.dot(along(angle())), expected, 0.02 * expected);
  EXPECT_LT(velocity.cross(along(angle())).norm(), 0.01 * expected);
}

TEST_P(Friction, StopsSlidingBoxOnStraightLine) {
  OnFloor cell;
  const Vector3d before = cell.part_position();
  Vector6d twist = Vector6d::Zero();
  twist.tail<3>() = along(angle());
  cell.box->setVelocities(twist);
  cell.run(300);
  const double distance = 1 / (2 * kContactFriction * kGravity);
  const Vector3d travel = cell.part_position() - before;
  EXPECT_NEAR(travel.dot(along(angle())), distance, 0.01 * distance);
  EXPECT_LT(travel.cross(along(angle())).norm(), 0.001 * distance);
  EXPECT_LT(cell.velocity().norm(), 1e-6);
}

INSTANTIATE_TEST_SUITE_P(Directions, Friction,
                         ::testing::Values(0, 10, 20, 30, 45, 60, 75, 90, 135, 200, 315));

TEST(FrictionMoment, SlowsSpinningBoxOnItsCorners) {
  OnFloor cell;
  Vector6d twist = Vector6d::Zero();
  twist[2] = 20;
  cell.box->setVelocities(twist);
  cell.run(40);
  const double radius = kSize.head<2>().norm() / 2;
  const double gyration_squared = kSize.head<2>().squaredNorm() / 12;
  const double expected = 20 - kContactFriction * kGravity * radius / gyration_squared * 0.04;
  EXPECT_NEAR(cell.box->getVelocities()[2], expected, 0.01 * (20 - expected));
  EXPECT_LT(cell.velocity().norm(), 1e-3);
}

/// Reason for the cone: DART's own solver sticks up to 1.41 times the limit along the diagonal.
TEST(FrictionPyramid, ExceedsConeAlongEdges) {
  OnFloor pyramid(std::make_shared<dart::constraint::DantzigBoxedLcpSolver>());
  EXPECT_LT(pulled(pyramid, M_PI / 4, 1.40).norm(), 1e-6);
}

Hull prism(int sides, double radius, double height) {
  Hull hull;
  for (const double z : {0.0, height}) {
    for (int i = 0; i < sides; ++i) {
      const double angle = 2 * M_PI * i / sides;
      hull.vertices.emplace_back(radius * std::cos(angle), radius * std::sin(angle), z);
    }
  }
  for (int i = 0; i < sides; ++i) {
    const int k = (i + 1) % sides;
    if (i > 0 && k > 0) hull.faces.push_back({0, k, i});
    if (i > 0 && k > 0) hull.faces.push_back({sides, sides + i, sides + k});
    hull.faces.push_back({i, k, sides + k});
    hull.faces.push_back({i, sides + k, sides + i});
  }
  return hull;
}

/// However many bodies there are, each one has its contacts; pairs with more than ODE finds are counted.
TEST(Contacts, AreBoundedForEachPairAndNotInTotal) {
  for (const auto& [sides, truncated] : {std::pair(48, 0), std::pair(600, 40)}) {
    const auto world = make_world(std::make_shared<CoulombSolver>());
    add_floor(world, 0.5);
    const PlacedShape shape = make_mesh_shape(prism(sides, 0.02, 0.03));
    for (int i = 0; i < 40; ++i) {
      SkeletonPtr skeleton = Skeleton::create("prism " + std::to_string(i));
      BodyNode* body = skeleton->createJointAndBodyNodePair<FreeJoint>().second;
      body->createShapeNodeWith<CollisionAspect, DynamicsAspect>(shape.shape);
      const Isometry3d pose(Eigen::Translation3d(0.05 * (i % 8), 0.05 * (i / 8), -1e-5));
      skeleton->setPositions(FreeJoint::convertToPositions(pose * shape.hull_from_shape));
      world->addSkeleton(skeleton);
    }
    auto* solver = world->getConstraintSolver();
    dart::collision::CollisionResult found;
    solver->getCollisionGroup()->collide(solver->getCollisionOption(), &found);
    EXPECT_EQ(found.getNumContacts(), 160u);
    const auto detector = std::dynamic_pointer_cast<CappedCollisionDetector>(solver->getCollisionDetector());
    ASSERT_TRUE(detector);
    EXPECT_EQ(detector->truncated(), truncated) << sides;
  }
}

}  // namespace
