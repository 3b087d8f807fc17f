#include "fmu/model/world/gripper_body.h"

#include <algorithm>
#include <cmath>
#include <dart/constraint/ConstraintSolver.hpp>
#include <dart/dynamics/BoxShape.hpp>
#include <dart/dynamics/PrismaticJoint.hpp>
#include <dart/dynamics/Skeleton.hpp>

namespace robotcell {
namespace {

using namespace dart::dynamics;
using Eigen::Isometry3d;
using Eigen::Vector3d;

/// Fraction of the remaining distance to the commanded width covered in one step, within the limits of speed
/// and force.
constexpr double kApproachGain = 0.5;

constexpr double kStandstill = 1e-3;   // m/s
constexpr double kFullForce = 0.9;     // fraction of the force limit that counts as the full force
constexpr double kClosedWidth = 1e-4;  // m, below which the gripper counts as closed

BodyNode* add_finger(const GripperDescription& gripper, BodyNode* flange, std::size_t number) {
  const std::string name = "finger" + std::to_string(number + 1);
  PrismaticJoint::Properties joint;
  joint.mName = name;
  joint.mAxis = Vector3d::UnitX();
  joint.mT_ParentBodyToJoint = gripper.flange_from_finger(number, 0);
  BodyNode::Properties properties(BodyNode::AspectProperties{name});
  BodyNode* finger = flange->createChildJointAndBodyNodePair<PrismaticJoint>(joint, properties).second;
  const Vector3d centre(gripper.finger.x() / 2, 0, gripper.finger.z() / 2);
  finger->setInertia(
      {gripper.finger_mass, centre, BoxShape::computeInertia(gripper.finger, gripper.finger_mass)});
  ShapeNode* pad = finger->createShapeNodeWith<CollisionAspect, DynamicsAspect>(
      std::make_shared<BoxShape>(gripper.finger));
  pad->setRelativeTranslation(centre);
  pad->getDynamicsAspect()->setFrictionCoeff(gripper.friction);
  return finger;
}

}  // namespace

Gripper::Gripper(const GripperDescription& description, BodyNode* flange, double time_step)
    : description_(description), time_step_(time_step) {
  fingers_ = {add_finger(description, flange, 0), add_finger(description, flange, 1)};
  drives_ = std::make_shared<FingerDrives>(fingers_, description.centring_stiffness, time_step);
  for (BodyNode* finger : fingers_) finger->getParentJoint()->setPosition(0, description.start / 2);
  command_ = {static_cast<std::int32_t>(GripperMode::kWidth), description.start, description.max_force};
}

void Gripper::connect(const dart::simulation::WorldPtr& world) {
  world->getConstraintSolver()->addConstraint(drives_);
}

void Gripper::command(const GripperCommand& command) {
  if (command.is(GripperMode::kKeep)) return;
  command_.mode = command.mode;
  command_.width = std::clamp(command.width, 0.0, description_.stroke);
  command_.force = std::clamp(command.force, 0.0, description_.max_force);
}

FingerDrive Gripper::drive(std::size_t finger) const {
  const bool to_width = command_.is(GripperMode::kWidth);
  const double remaining = (to_width ? command_.width / 2 : 0) - opening(finger);
  const double speed =
      std::clamp(kApproachGain * remaining / time_step_, -description_.max_speed, description_.max_speed);
  return {speed, force_limit()};
}

double Gripper::force_limit() const {
  return command_.is(GripperMode::kWidth) ? description_.max_force : command_.force;
}

void Gripper::begin_step() { drives_->set({drive(0), drive(1)}); }

void Gripper::end_step() { drive_force_ = -(drives_->forces()[0] + drives_->forces()[1]) / 2; }

bool Gripper::is_gripping() const {
  const double wanted = force_limit();
  return wanted > 0 && drive_force_ > kFullForce * wanted && width() > kClosedWidth &&
         std::abs(speed(0) + speed(1)) < kStandstill;
}

GripperState Gripper::state() const {
  return {command_, {opening(0), opening(1)}, {speed(0), speed(1)}, drive_force_};
}

void Gripper::restore(const GripperState& state) {
  command_ = state.command;
  drive_force_ = state.drive_force;
  for (std::size_t i = 0; i < 2; ++i) {
    fingers_[i]->getParentJoint()->setPosition(0, state.opening[i]);
    fingers_[i]->getParentJoint()->setVelocity(0, state.speed[i]);
  }
}

}  // namespace robotcell
