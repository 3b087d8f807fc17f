#include "fmu/model/world/dynamic_arm.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <dart/dynamics/Inertia.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <utility>

namespace robotcell {
namespace {

constexpr int kSettlingIterations = 200;
constexpr int kFrictionSweeps = 200;
constexpr double kFrictionAccuracy = 1e-12;

double sign(double x) { return x > 0 ? 1 : x < 0 ? -1 : 0; }

}  // namespace

DynamicArm::DynamicArm(dart::dynamics::SkeletonPtr arm, const ArmDynamicsDescription& description,
                       std::vector<std::array<double, 2>> limits)
    : arm_(std::move(arm)), description_(description), limits_(std::move(limits)) {
  first_dof_ = arm_->getNumDofs() - joints();
  for (std::size_t i = 0; i < joints(); ++i) {
    const RigidInertia& link = description.links[i];
    dof(i)->getJoint()->setActuatorType(dart::dynamics::Joint::FORCE);
    dof(i)->getChildBodyNode()->setInertia({link.mass, link.centre_of_mass, link.inertia});
  }
  arm_->setMobile(true);
}

void DynamicArm::write_engine_state() {
  for (std::size_t i = 0; i < joints(); ++i) {
    dof(i)->setPosition(state_.position[i]);
    dof(i)->setVelocity(state_.rate[i]);
  }
}

void DynamicArm::settle(const std::array<double, kAxes>& axes) {
  state_ = {};
  for (std::size_t i = 0; i < joints(); ++i) state_.motors[i].position = state_.position[i] = axes[i];
  // Fixed-point iteration; it converges fast because the deflections are small.
  for (int k = 0; k < kSettlingIterations; ++k) {
    write_engine_state();
    const Eigen::VectorXd gravity = arm_->getGravityForces();
    for (std::size_t i = 0; i < joints(); ++i) {
      const DriveDescription& drive = description_.drives[i];
      const double load = gravity[static_cast<int>(first_dof_ + i)];
      const double free = axes[i] - load / drive.gear_stiffness - sign(load) * drive.backlash / 2;
      state_.position[i] = std::clamp(free, limits_[i][0], limits_[i][1]);
      state_.gear_torque[i] = load;
      state_.motors[i].torque = load;
    }
  }
  write_engine_state();
}

void DynamicArm::before_step(const std::array<MotorCommand, kMaxJoints>& command, double step) {
  step_ = step;
  for (std::size_t i = 0; i < joints(); ++i) {
    const DriveDescription& drive = description_.drives[i];
    state_.motors[i] = next_motor(drive, state_.motors[i], command[i], state_.gear_torque[i], step);
    const MotorState& motor = state_.motors[i];
    gears_[i] = gear_contact(drive, motor.position, state_.position[i] + step * state_.rate[i]);
    dof(i)->setRestPosition(gears_[i].rest);
    dof(i)->setSpringStiffness(gears_[i].stiffness);
    // The engine damps the link against the link before; the gear damps it against the motor.
    dof(i)->setDampingCoefficient(gears_[i].damping + drive.viscous_friction);
    motor_damping_torque_[i] = gears_[i].damping * motor.rate;
  }
  const Torques friction = friction_torques();
  for (std::size_t i = 0; i < joints(); ++i) {
    dof(i)->setForce(motor_damping_torque_[i] + friction[static_cast<int>(i)]);
  }
}

/// Coulomb friction torques of the step, at which a joint either stops or slips at the full torque.
///
/// With A = M + step D + step^2 K of the implicit rule the rates after the step are A^-1 (b + step f). Every
/// f is within its bounds, and at them unless its rate is 0. Solved by projected Gauss-Seidel, which
/// converges for a positive definite A. The joint friction of the engine ignores the springs in A.
DynamicArm::Torques DynamicArm::friction_torques() {
  const auto n = static_cast<int>(joints()), first = static_cast<int>(first_dof_);
  Torques bound(n), push(n), friction = Torques::Zero(n);
  const Eigen::MatrixXd& masses = arm_->getMassMatrix();
  Inertias implicit = masses.block(first, first, n, n);  // the arm without the gripper's fingers
  const Torques momentum = implicit * arm_->getVelocities().segment(first, n);
  Torques bias = arm_->getCoriolisAndGravityForces().segment(first, n);
  if (first > 0) {  // inertial forces of the base, which an axis accelerates
    const auto* base = arm_->getJoint(0);
    bias += masses.block(first, 0, n, first) * (base->getCommands() - base->getVelocities()) / step_;
  }
  for (std::size_t i = 0; i < joints(); ++i) {
    const auto row = static_cast<int>(i);
    const GearContact& gear = gears_[i];
    const DriveDescription& drive = description_.drives[i];
    bound[row] = drive.coulomb_friction;
    push[row] = gear.stiffness * (gear.rest - state_.position[i]) + motor_damping_torque_[i] - bias[row];
    implicit(row, row) += step_ * (gear.damping + drive.viscous_friction + step_ * gear.stiffness);
  }
  if (bound.isZero(0)) return friction;
  const Inertias inverse = implicit.inverse();
  const Torques free = inverse * (momentum + step_ * push);
  for (int sweep = 0; sweep < kFrictionSweeps; ++sweep) {
    double change = 0;
    for (int i = 0; i < n; ++i) {
      const double rate = free[i] + step_ * inverse.row(i).dot(friction);
      const double next = std::clamp(friction[i] - rate / (step_ * inverse(i, i)), -bound[i], bound[i]);
      change = std::max(change, std::abs(next - friction[i]));
      friction[i] = next;
    }
    if (change < kFrictionAccuracy * bound.maxCoeff()) return friction;
  }
  ++unconverged_;
  return friction;
}

void DynamicArm::after_step() {
  for (std::size_t i = 0; i < joints(); ++i) {
    const GearContact& gear = gears_[i];
    state_.position[i] = dof(i)->getPosition();
    state_.rate[i] = dof(i)->getVelocity();
    // The engine computes the gear torque before the contact impulses change the rate.
    const double impulse_velocity = dof(i)->getVelocityChange();
    state_.gear_torque[i] = gear.stiffness * (gear.rest - state_.position[i] + step_ * impulse_velocity) +
                            gear.damping * (state_.motors[i].rate - state_.rate[i] + impulse_velocity);
    const double inside = std::clamp(state_.position[i], limits_[i][0], limits_[i][1]);
    if (inside != state_.position[i]) {  // hard stop
      state_.position[i] = inside;
      state_.rate[i] = 0;
    }
  }
  write_engine_state();
}

void DynamicArm::restore(const ArmDynamicsState& state) {
  state_ = state;
  write_engine_state();
}

}  // namespace robotcell
