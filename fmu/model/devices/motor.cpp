#include "fmu/model/devices/motor.h"

#include <algorithm>
#include <cmath>

namespace robotcell {
namespace {

constexpr double kBandwidth = 100;           // rad/s, of the position control after saturation
constexpr double kPositionTolerance = 1e-7;  // rad
constexpr double kRateTolerance = 1e-5;      // rad/s

}  // namespace

MotorState next_motor(const DriveDescription& drive, const MotorState& motor, const MotorCommand& command,
                      double load, double step) {
  const double error = command.position - motor.position;
  const double rate_error = command.rate - motor.rate;
  const bool on_track = !motor.catching_up || (std::abs(error - step * command.rate) < kPositionTolerance &&
                                               std::abs(rate_error) < kRateTolerance);
  const double required_torque = drive.motor_inertia * rate_error / step + load;
  if (on_track && std::abs(required_torque) <= drive.max_torque) {
    return {command.position, command.rate, required_torque, false};
  }

  const double bandwidth = std::min(kBandwidth, 0.2 / step);
  const double acceleration = bandwidth * (bandwidth * error + 2 * rate_error);
  MotorState next;
  next.catching_up = true;
  next.torque = std::clamp(drive.motor_inertia * acceleration + load, -drive.max_torque, drive.max_torque);
  next.rate = motor.rate + step * (next.torque - load) / drive.motor_inertia;
  next.position = motor.position + step * next.rate;
  return next;
}

GearContact gear_contact(const DriveDescription& drive, double motor, double link) {
  const double half = drive.backlash / 2;
  const double rest = std::clamp(link, motor - half, motor + half);
  const bool touches = drive.backlash == 0 || rest != link;
  return {rest, touches ? drive.gear_stiffness : 0, touches ? drive.gear_damping : 0};
}

}  // namespace robotcell
