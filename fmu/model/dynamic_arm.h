// The arm with masses and real drives, as bodies of the dynamics engine.
#pragma once

#include <array>
#include <dart/dynamics/SmartPointer.hpp>
#include <vector>

#include "fmu/model/arm_dynamics.h"

namespace robotcell {

/// Every joint is driven through a gear: a spring and damper between motor and link, treated implicitly by
/// the engine, so that stiff gears are stable; friction acts on the link. The engine integrates with the
/// first-order implicit rule: an oscillation of angular frequency w loses, besides its physical damping, the
/// share w * step / 2 of critical damping.
class DynamicArm {
 public:
  /// Gives masses to the bodies of a skeleton of six revolute joints; `limits` are (lower, upper).
  DynamicArm(dart::dynamics::SkeletonPtr arm, const ArmDynamicsDescription& description,
             const std::array<std::array<double, 2>, kJoints>& limits);

  /// The rest under gravity, with the motors at some positions.
  void settle(const std::array<double, kJoints>& motors);

  /// Before and after a step of the engine (seconds); the motors go to `command`.
  void before_step(const std::array<MotorCommand, kJoints>& command, double step);
  void after_step();

  const ArmDynamicsState& state() const { return state_; }
  void restore(const ArmDynamicsState& state);

 private:
  using Torques = Eigen::Matrix<double, kJoints, 1>;
  void place();
  Torques friction_torques() const;

  dart::dynamics::SkeletonPtr arm_;
  ArmDynamicsDescription description_;
  std::array<std::array<double, 2>, kJoints> limits_;
  double step_ = 0;                           // s, of the running step
  std::array<GearContact, kJoints> gears_{};  // in it
  std::array<double, kJoints> gear_push_{};   // N m, in it: what turning motors add by damping
  ArmDynamicsState state_;
};

}  // namespace robotcell
