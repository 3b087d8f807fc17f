// The arm with link masses and dynamic drives, as bodies of the dynamics engine.
#pragma once

#include <array>
#include <dart/dynamics/SmartPointer.hpp>
#include <vector>

#include "fmu/model/arm_dynamics.h"

namespace robotcell {

/// Every joint is driven through a gear: a spring and damper between motor and link, integrated implicitly by
/// the engine, so that stiff gears are stable. Friction acts on the link. The first-order implicit rule adds
/// numerical damping: for an oscillation of angular frequency w, the fraction w * step / 2 of critical
/// damping.
class DynamicArm {
 public:
  /// Sets masses and actuators of a skeleton of six revolute joints; `limits` holds (lower, upper).
  DynamicArm(dart::dynamics::SkeletonPtr arm, const ArmDynamicsDescription& description,
             const std::array<std::array<double, 2>, kJoints>& limits);

  /// Finds the static equilibrium under gravity for given motor positions.
  void settle(const std::array<double, kJoints>& motors);

  /// Call before and after a step of the engine (seconds); the motors follow `command`.
  void before_step(const std::array<MotorCommand, kJoints>& command, double step);
  void after_step();

  const ArmDynamicsState& state() const { return state_; }
  void restore(const ArmDynamicsState& state);

 private:
  using Torques = Eigen::Matrix<double, kJoints, 1>;
  void write_engine_state();
  Torques friction_torques() const;

  dart::dynamics::SkeletonPtr arm_;
  ArmDynamicsDescription description_;
  std::array<std::array<double, 2>, kJoints> limits_;
  double step_ = 0;                           // s, of the current step
  std::array<GearContact, kJoints> gears_{};  // in the current step
  std::array<double, kJoints>
      motor_damping_torque_{};  // N m, in the current step: gear damping torque from the rate of the motor
  ArmDynamicsState state_;
};

}  // namespace robotcell
