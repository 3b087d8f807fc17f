// Motor and gear of a dynamic drive: follows its set-points within its torque limit.
#pragma once

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

struct MotorState {
  double position = 0, rate = 0;  // rad, rad/s, referred to the output side of the gear
  double torque = 0;              // N m, of the last step
  bool catching_up = false;       // saturated before; returns to the set-points
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
