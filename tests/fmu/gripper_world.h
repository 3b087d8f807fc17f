// A gripper on a carriage with prescribed motion.
#pragma once

#include <dart/dynamics/PrismaticJoint.hpp>

#include "fmu/model/world/coulomb_solver.h"
#include "fmu/model/world/gripper_body.h"
#include "tests/fmu/engine_world.h"

namespace robotcell::testing {

constexpr double kPadFriction = 0.5;
constexpr double kPartMass = 0.4;
const Vector3d kPartSize(0.03, 0.03, 0.03);

inline GripperDescription a_gripper() {
  GripperDescription gripper;
  gripper.stroke = 0.08;
  gripper.finger = {0.01, 0.02, 0.06};
  gripper.finger_mass = 0.1;
  gripper.max_force = 60;
  gripper.max_speed = 0.1;
  gripper.friction = kPadFriction;
  gripper.centring_stiffness = 2e4;
  gripper.start = 0.06;
  return gripper;
}

/// The gripper frame is aligned with the world at the start; a cube floats between the pads. No gravity by
/// default.
class GripperWorld {
 public:
  explicit GripperWorld(const dart::constraint::BoxedLcpSolverPtr& solver = std::make_shared<CoulombSolver>(),
                        const GripperDescription& description = a_gripper(),
                        const Vector3d& part_size = kPartSize, const Vector3d& part_place = {0, 0, 0.04})
      : world(make_world(solver)), carriage(Skeleton::create("carriage")) {
    BodyNode* flange = nullptr;
    for (int i = 0; i < 3; ++i) {
      dart::dynamics::PrismaticJoint::Properties joint;
      joint.mName = "slide" + std::to_string(i);
      joint.mAxis = Vector3d::Unit(i);
      joint.mActuatorType = dart::dynamics::Joint::VELOCITY;
      const BodyNode::Properties slide(BodyNode::AspectProperties(joint.mName));
      flange =
          carriage->createJointAndBodyNodePair<dart::dynamics::PrismaticJoint>(flange, joint, slide).second;
    }
    gripper = std::make_unique<Gripper>(description, flange, kStep);
    world->setGravity(Vector3d::Zero());
    world->addSkeleton(carriage);
    gripper->connect(world);
    part =
        add_free_box(world, "part", part_size, kPartMass, 1.0, Isometry3d(Eigen::Translation3d(part_place)));
  }

  void set_max_contacts(std::size_t most) {
    auto* detector =
        static_cast<CappedCollisionDetector*>(world->getConstraintSolver()->getCollisionDetector().get());
    for (std::size_t i = 0; i < 2; ++i) {
      detector->set_max_contacts(gripper->pad(i), body()->getShapeNode(0), most);
    }
  }

  void step(const Vector3d& acceleration = Vector3d::Zero()) {
    for (int i = 0; i < 3; ++i) {
      const auto slide = static_cast<std::size_t>(i);
      carriage->setCommand(slide, carriage->getVelocity(slide) + acceleration[i] * kStep);
    }
    gripper->begin_step();
    world->step();
    gripper->end_step();
  }

  void run(int steps, const Vector3d& acceleration = Vector3d::Zero()) {
    for (int i = 0; i < steps; ++i) step(acceleration);
  }

  void grip(double force) {
    gripper->command({static_cast<std::int32_t>(GripperMode::kForce), 0, force});
    run(400);
  }

  BodyNode* flange() const { return carriage->getBodyNode(2); }
  BodyNode* body() const { return part->getBodyNode(0); }
  Isometry3d flange_from_part() const {
    return flange()->getWorldTransform().inverse() * body()->getWorldTransform();
  }
  Vector3d part_in_gripper() const { return flange_from_part().translation(); }
  Vector3d slip_speed() const { return body()->getLinearVelocity() - flange()->getLinearVelocity(); }

  dart::simulation::WorldPtr world;
  SkeletonPtr carriage, part;
  std::unique_ptr<Gripper> gripper;
};

}  // namespace robotcell::testing
