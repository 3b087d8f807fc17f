#include "fmu/model/devices/arm_dynamics.h"

namespace robotcell {
namespace {

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

}  // namespace robotcell
