// Soft parts against closed forms: spring compression and Coulomb's limit.
#include "fmu/model/world/soft_body.h"

#include <gtest/gtest.h>

#include <dart/dynamics/SoftBodyNode.hpp>

#include "fmu/model/description/cell_description.h"
#include "fmu/model/world/soft_collision_detector.h"
#include "tests/fmu/gripper_world.h"

namespace {

using namespace robotcell;
using namespace robotcell::testing;

constexpr double kEdge = 0.03;
constexpr double kMass = 0.1;
constexpr double kForce = 4;

/// A cube on z = 0, of uniform density.
PartDescription soft_cube(const SoftDescription& soft) {
  PartDescription part;
  part.inertial.mass = kMass;
  part.friction = 1.0;
  part.inertial.centre_of_mass = {0, 0, kEdge / 2};
  part.inertial.inertia = BoxShape::computeInertia({kEdge, kEdge, kEdge}, kMass);
  part.soft = soft;
  for (const double z : {0.0, kEdge}) {
    for (const auto& [x, y] : {std::pair(-1, -1), {1, -1}, {1, 1}, {-1, 1}}) {
      part.hull.vertices.emplace_back(x * kEdge / 2, y * kEdge / 2, z);
    }
  }
  const std::array<std::array<int, 4>, 6> quads{
      {{3, 2, 1, 0}, {4, 5, 6, 7}, {0, 1, 5, 4}, {1, 2, 6, 5}, {2, 3, 7, 6}, {3, 0, 4, 7}}};
  for (const auto& q : quads) {
    part.hull.faces.push_back({q[0], q[1], q[2]});
    part.hull.faces.push_back({q[0], q[2], q[3]});
  }
  return part;
}

SkeletonPtr add_soft_cube(const dart::simulation::WorldPtr& world, SoftCollisionDetector& detector,
                          const SoftDescription& soft, const Vector3d& place) {
  const PartDescription part = soft_cube(soft);
  SkeletonPtr cube = make_soft_part("soft", part, part.hull, kStep);
  cube->setPositions(FreeJoint::convertToPositions(Isometry3d(Eigen::Translation3d(place))));
  world->addSkeleton(cube);
  detector.add_soft(soft_surface(cube->getBodyNode(0)));
  return cube;
}

std::size_t contacts_in(const dart::simulation::World& world) {
  return world.getConstraintSolver()->getLastCollisionResult().getNumContacts();
}

/// Length of the longest edge, and the vector sum of the face areas, zero for a closed surface.
std::pair<double, double> longest_and_gap(const Hull& hull) {
  double longest = 0;
  Vector3d gap = Vector3d::Zero();
  for (const auto& face : hull.faces) {
    std::array<Vector3d, 3> corner;
    for (std::size_t k = 0; k < 3; ++k) corner[k] = hull.vertices[static_cast<std::size_t>(face[k])];
    for (std::size_t k = 0; k < 3; ++k) longest = std::max(longest, (corner[k] - corner[(k + 1) % 3]).norm());
    gap += (corner[1] - corner[0]).cross(corner[2] - corner[0]);
  }
  return {longest, gap.norm()};
}

TEST(SoftSurface, RefinementIsWatertightAndKeepsEulerCharacteristic) {
  const PartDescription part = soft_cube({100, 1, 1});
  for (const double limit : {0.05, 0.025, 0.012, 0.009}) {
    const Hull fine = refine(part.hull, limit);
    const auto [longest, gap] = longest_and_gap(fine);
    EXPECT_LE(longest, limit);
    EXPECT_LT(gap, 1e-15);
    EXPECT_EQ(fine.vertices.size(), fine.faces.size() / 2 + 2);  // V - E + F = 2, E = 3 F / 2
    for (const Vector3d& v : fine.vertices) {
      const double outermost = (v - Vector3d(0, 0, kEdge / 2)).cwiseAbs().maxCoeff();
      EXPECT_NEAR(outermost, kEdge / 2, 1e-15);
    }
  }
}

/// Inertia of a point mass about the origin.
Eigen::Matrix3d about_origin(double mass, const Vector3d& r) {
  return mass * (r.squaredNorm() * Eigen::Matrix3d::Identity() - r * r.transpose());
}

TEST(SoftPartBody, HasMassAndInertiaOfDescription) {
  const PartDescription part = soft_cube({100, 1, 0.02});
  const SkeletonPtr cube = make_soft_part("soft", part, part.hull, kStep);
  const auto* body = cube->getBodyNode(0)->asSoftBodyNode();
  const auto& core = body->getInertia();
  double mass = core.getMass();
  Vector3d moment = mass * core.getLocalCOM();
  Eigen::Matrix3d inertia = core.getMoment() + about_origin(mass, core.getLocalCOM());
  for (const auto* point : body->getPointMasses()) {
    mass += point->getMass();
    moment += point->getMass() * point->getRestingPosition();
    inertia += about_origin(point->getMass(), point->getRestingPosition());
  }
  EXPECT_NEAR(mass, kMass, 1e-15);
  EXPECT_LT((moment - kMass * part.inertial.centre_of_mass).norm(), 1e-15);
  EXPECT_LT((inertia - part.inertial.inertia - about_origin(kMass, part.inertial.centre_of_mass)).norm(),
            1e-15);
}

class SoftPart : public ::testing::TestWithParam<std::pair<double, double>> {
 protected:
  SoftDescription description() const { return {GetParam().first, 1.0, GetParam().second}; }
};

/// On n points the part compresses by its weight over n springs. Between none and all of the weight of these
/// points rests directly on the floor.
TEST_P(SoftPart, ComesToRestOnItsSprings) {
  auto world = make_world(std::make_shared<CoulombSolver>());
  const auto detector = SoftCollisionDetector::create(4);
  world->getConstraintSolver()->setCollisionDetector(detector);
  detector->add_obstacle(add_floor(world, 0.5)->getBodyNode(0)->getShapeNode(0));
  const SkeletonPtr cube = add_soft_cube(world, *detector, description(), Vector3d::Zero());
  const auto* body = cube->getBodyNode(0)->asSoftBodyNode();
  for (int i = 0; i < 1000; ++i) world->step();
  Vector3d force = Vector3d::Zero();
  for (const auto& contact : world->getConstraintSolver()->getLastCollisionResult().getContacts()) {
    force += contact.force;
  }
  const auto bearing = static_cast<double>(contacts_in(*world));
  const double sinking = -body->getWorldTransform().translation().z();
  const double most = kMass * kGravity / (bearing * description().stiffness);
  EXPECT_TRUE(force.isApprox(Vector3d(0, 0, kMass * kGravity), 1e-6)) << force;
  EXPECT_LT(sinking, most);
  EXPECT_GT(sinking, most * (1 - bearing * body->getPointMass(0)->getMass() / kMass));
  EXPECT_LT(body->getLinearVelocity().norm(), 1e-9);
}

/// A soft cube between pads wider than the cube.
struct SoftGrasp : GripperWorld {
  explicit SoftGrasp(const SoftDescription& description)
      : GripperWorld(std::make_shared<CoulombSolver>(), wide(), kPartSize, {0, 0, 5}) {
    const auto detector = SoftCollisionDetector::create(4);
    world->getConstraintSolver()->setCollisionDetector(detector);
    soft = add_soft_cube(world, *detector, description, {0, 0, 0.025});
    for (std::size_t i = 0; i < 2; ++i) detector->add_obstacle(gripper->pad(i));
    grip(kForce);
  }

  static GripperDescription wide() {
    GripperDescription gripper = a_gripper();
    gripper.finger.y() = 0.04;
    return gripper;
  }
  Vector3d part_position() const {
    return flange()->getWorldTransform().inverse() * soft->getBodyNode(0)->getWorldTransform().translation();
  }
  double slip_speed() const {
    return (soft->getBodyNode(0)->getLinearVelocity() - flange()->getLinearVelocity()).norm();
  }

  SkeletonPtr soft;
};

constexpr double kSoftLimit = 2 * kPadFriction * kForce / kMass;

TEST_P(SoftPart, CompressionMatchesSpringStiffness) {
  SoftGrasp cell(description());
  const double squeeze =
      kForce / (static_cast<double>(contacts_in(*cell.world)) / 2 * description().stiffness);
  EXPECT_NEAR((kEdge - cell.gripper->width()) / 2, squeeze, 0.01 * squeeze + 2e-5);
  EXPECT_TRUE(cell.gripper->is_gripping());
}

/// Its points deflect, and then only creep is left.
TEST_P(SoftPart, SticksBelowCoulombLimit) {
  SoftGrasp cell(description());
  cell.run(200, {0, 0, 0.98 * kSoftLimit});
  const Vector3d before = cell.part_position();
  cell.run(200, {0, 0, 0.98 * kSoftLimit});
  EXPECT_LT((cell.part_position() - before).norm(), 5e-6);
}

TEST_P(SoftPart, SlipsAboveLimitWithExcessForce) {
  SoftGrasp cell(description());
  cell.run(60, {0, 0, 1.02 * kSoftLimit});
  const double before = cell.slip_speed();
  cell.run(60, {0, 0, 1.02 * kSoftLimit});
  const double expected = 0.02 * kSoftLimit * 60 * kStep;
  EXPECT_NEAR(cell.slip_speed() - before, expected, 0.05 * expected);
}

INSTANTIATE_TEST_SUITE_P(StiffnessAndEdge, SoftPart,
                         ::testing::Values(std::pair(300.0, 0.05), std::pair(700.0, 0.05),
                                           std::pair(300.0, 0.025), std::pair(700.0, 0.025),
                                           std::pair(300.0, 0.016)));

}  // namespace
