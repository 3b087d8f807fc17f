#include "fmu/model/devices/arm_drives.h"

#include <algorithm>
#include <cmath>

namespace robotcell {
namespace {

constexpr double kBandwidth = 100;           // rad/s, of the position control after saturation
constexpr double kPositionTolerance = 1e-7;  // rad
constexpr double kRateTolerance = 1e-5;      // rad/s
constexpr double kMaxDriveValue = 1e9;

DriveDescription parse_drive(const JsonReader& json, double time_step) {
  json.expect_keys({"motor_inertia", "max_torque", "gear_stiffness", "gear_damping", "backlash",
                    "coulomb_friction", "viscous_friction"});
  DriveDescription drive;
  drive.motor_inertia = json.at("motor_inertia").positive();
  drive.max_torque = json.at("max_torque").number(0, kMaxDriveValue);
  drive.gear_stiffness = json.at("gear_stiffness").positive();
  drive.gear_damping = json.at("gear_damping").number(0, kMaxDriveValue);
  drive.backlash = json.at("backlash").number(0, 1);
  drive.coulomb_friction = json.at("coulomb_friction").number(0, kMaxDriveValue);
  drive.viscous_friction = json.at("viscous_friction").number(0, kMaxDriveValue);
  // The reaction of the gear reaches the motor one step late: with less inertia a saturated motor would
  // oscillate.
  const double needed = drive.gear_stiffness * time_step * time_step;
  if (drive.motor_inertia < needed) {
    json.at("motor_inertia")
        .fail("at least gear_stiffness * time_step^2 = " + std::to_string(needed) +
              ", for a stable motor at this time step");
  }
  return drive;
}

}  // namespace

ArmDynamicsDescription parse_arm_dynamics(const JsonReader& json, std::size_t joints, double time_step) {
  json.expect_keys({"links", "drives"});
  ArmDynamicsDescription dynamics;
  for (const JsonReader& link : json.at("links").items(joints)) dynamics.links.push_back(parse_inertia(link));
  for (const JsonReader& drive : json.at("drives").items(joints)) {
    dynamics.drives.push_back(parse_drive(drive, time_step));
  }
  return dynamics;
}

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
