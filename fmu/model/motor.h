// The motor of a dynamic drive: goes where the controller wants it, as far as its torque reaches.
#pragma once

namespace robotcell {

/// One drive, seen from the joint (behind the gear).
struct DriveDescription {
  double motor_inertia = 0;     // kg m^2
  double max_torque = 0;        // N m
  double gear_stiffness = 0;    // N m/rad
  double gear_damping = 0;      // N m s/rad
  double backlash = 0;          // rad, the whole width
  double coulomb_friction = 0;  // N m, of the joint
  double viscous_friction = 0;  // N m s/rad, of the joint
};

struct MotorState {
  double position = 0, rate = 0;  // rad, rad/s, behind the gear
  double torque = 0;              // N m, that the motor gave in the last step
  bool lags = false;              // its torque did not reach; it catches up
};

/// The set-point at the end of a step.
struct MotorCommand {
  double position = 0, rate = 0;
};

/// One step (seconds) against the torque with which the gear loads the motor. While the torque suffices the
/// motor is where it should be, exactly; else it gives all it has, and returns by a critically damped
/// position control.
MotorState next_motor(const DriveDescription& drive, const MotorState& motor, const MotorCommand& command,
                      double load, double step);

/// How the gear connects motor and link in one step.
struct GearContact {
  double rest = 0;       // link position without torque, rad
  double stiffness = 0;  // N m/rad; 0 in the backlash
  double damping = 0;    // N m s/rad
};

/// `link` is where the link is about to be.
GearContact gear_contact(const DriveDescription& drive, double motor, double link);

}  // namespace robotcell
