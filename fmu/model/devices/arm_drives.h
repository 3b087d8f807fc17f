// Dynamic drives of the arm: description of masses, motors and gears, and their state.
#pragma once

#include <array>
#include <vector>

#include "fmu/model/axes_state.h"
#include "fmu/model/description/json_reader.h"
#include "fmu/model/description/rigid_inertia.h"
#include "fmu/model/fields.h"

namespace robotcell {

/// One drive, referred to the joint (output side of the gear).
struct DriveDescription {
  double motor_inertia = 0;     // kg m^2
  double max_torque = 0;        // N m
  double gear_stiffness = 0;    // N m/rad
  double gear_damping = 0;      // N m s/rad
  double backlash = 0;          // rad, full width
  double coulomb_friction = 0;  // N m, of the joint
  double viscous_friction = 0;  // N m s/rad, of the joint
};

struct ArmDynamicsDescription {
  std::vector<RigidInertia> links;  // in the link frames
  std::vector<DriveDescription> drives;
};

/// `time_step` (s) limits the stiffness of the gears. Throws DescriptionError.
ArmDynamicsDescription parse_arm_dynamics(const JsonReader& json, std::size_t joints, double time_step);

struct MotorState {
  double position = 0, rate = 0;  // rad, rad/s, referred to the output side of the gear
  double torque = 0;              // N m, of the last step
  bool catching_up = false;       // saturated before; returns to the set-points

  template <class Visitor>
  static void declare(Visitor& visit, MotorState& s) {
    visit(s, state(s.position, "position"), state(s.rate, "rate"), state(s.torque, "torque"),
          state(s.catching_up, "catching_up"));
  }
};

struct ArmDynamicsState {
  std::array<double, kMaxJoints> position{}, rate{};  // of the links, rad, rad/s
  std::array<double, kMaxJoints> gear_torque{};       // acting on the links, N m
  std::array<MotorState, kMaxJoints> motors{};

  template <class Visitor>
  static void declare(Visitor& visit, ArmDynamicsState& s) {
    visit(s, state(s.position, "position"), state(s.rate, "rate"), state(s.gear_torque, "gear_torque"),
          state(s.motors, "motors"));
  }
};

/// Set-point at the end of a step.
struct MotorCommand {
  double position = 0, rate = 0;
};

/// Advances the motor by one step (seconds) against the load torque of the gear. While the torque limit
/// suffices the motor follows its set-points exactly; else it saturates and returns by critically damped
/// position control.
MotorState next_motor(const DriveDescription& drive, const MotorState& motor, const MotorCommand& command,
                      double load, double step);

/// Linearised gear between motor and link in one step.
struct GearContact {
  double rest = 0;       // rad, link position at zero torque
  double stiffness = 0;  // N m/rad; 0 within the backlash
  double damping = 0;    // N m s/rad
};

/// `link` is the predicted link position.
GearContact gear_contact(const DriveDescription& drive, double motor, double link);

}  // namespace robotcell
