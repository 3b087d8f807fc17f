// The arm with link masses and dynamic drives, as bodies of the dynamics engine.
#pragma once

#include <array>
#include <cstdint>
#include <dart/dynamics/SmartPointer.hpp>
#include <vector>

#include "fmu/model/devices/arm_drives.h"

namespace robotcell {

/// Every joint is driven through a gear: a spring and damper between motor and link, integrated implicitly by
/// the engine, so that stiff gears are stable. Friction acts on the link. The first-order implicit rule adds
/// numerical damping: for an oscillation of angular frequency w, the fraction w * step / 2 of critical
/// damping.
class DynamicArm {
 public:
  /// Sets masses and actuators of the last bodies of a skeleton but the fingers: links on revolute joints,
  /// behind the base if an axis carries it; `limits` holds (lower, upper) of each.
  DynamicArm(dart::dynamics::SkeletonPtr arm, const ArmDynamicsDescription& description,
             std::vector<std::array<double, 2>> limits);

  /// Finds the static equilibrium under gravity for given motor positions, the first of `axes`.
  void settle(const std::array<double, kAxes>& axes);

  /// Call before and after a step of the engine (seconds); the motors follow `command`.
  void before_step(const std::array<MotorCommand, kMaxJoints>& command, double step);
  void after_step();

  /// Number of steps since the construction in which the friction torques did not converge.
  std::int32_t unconverged() const { return unconverged_; }

  const ArmDynamicsState& state() const { return state_; }
  void restore(const ArmDynamicsState& state);

 private:
  using Torques = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxJoints, 1>;
  using Inertias = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxJoints, kMaxJoints>;
  std::size_t joints() const { return limits_.size(); }
  dart::dynamics::DegreeOfFreedom* dof(std::size_t joint) const { return arm_->getDof(first_dof_ + joint); }
  void write_engine_state();
  Torques friction_torques();

  dart::dynamics::SkeletonPtr arm_;
  std::size_t first_dof_ = 0;  // of the joints, behind those of a base that an axis carries
  ArmDynamicsDescription description_;
  std::vector<std::array<double, 2>> limits_;
  double step_ = 0;                              // s, of the current step
  std::array<GearContact, kMaxJoints> gears_{};  // in the current step
  std::array<double, kMaxJoints>
      motor_damping_torque_{};  // N m, in the current step: gear damping torque from the rate of the motor
  ArmDynamicsState state_;
  std::int32_t unconverged_ = 0;
};

}  // namespace robotcell
