#include "fmu/model/arm_dynamics.h"

#include <Eigen/Cholesky>

namespace robotcell {
namespace {

constexpr double kHuge = 1e9;

LinkInertia parse_link(const JsonReader& json) {
  json.expect_keys({"mass", "centre_of_mass", "inertia"});
  LinkInertia link;
  link.mass = json.at("mass").mass();
  link.centre_of_mass = json.at("centre_of_mass").coordinates();
  const auto rows = json.at("inertia").items(3);
  for (int i = 0; i < 3; ++i) link.inertia.row(i) = rows[static_cast<std::size_t>(i)].vector3();
  if (link.inertia.llt().info() != Eigen::Success) {
    json.at("inertia").fail("a positive definite matrix");
  }
  return link;
}

DriveDescription parse_drive(const JsonReader& json, double time_step) {
  json.expect_keys({"motor_inertia", "max_torque", "gear_stiffness", "gear_damping", "backlash",
                    "coulomb_friction", "viscous_friction"});
  DriveDescription drive;
  drive.motor_inertia = json.at("motor_inertia").positive();
  drive.max_torque = json.at("max_torque").number(0, kHuge);
  drive.gear_stiffness = json.at("gear_stiffness").positive();
  drive.gear_damping = json.at("gear_damping").number(0, kHuge);
  drive.backlash = json.at("backlash").number(0, 1);
  drive.coulomb_friction = json.at("coulomb_friction").number(0, kHuge);
  drive.viscous_friction = json.at("viscous_friction").number(0, kHuge);
  // A motor whose torque does not reach swings against its gear, one step late.
  const double needed = drive.gear_stiffness * time_step * time_step;
  if (drive.motor_inertia < needed) {
    json.at("motor_inertia")
        .fail("at least gear_stiffness * time_step^2, " + std::to_string(needed) +
              ", for the motor to swing no faster than the steps can follow");
  }
  return drive;
}

}  // namespace

ArmDynamicsDescription parse_arm_dynamics(const JsonReader& json, double time_step) {
  json.expect_keys({"links", "drives"});
  ArmDynamicsDescription dynamics;
  const auto links = json.at("links").items(kJoints);
  const auto drives = json.at("drives").items(kJoints);
  for (std::size_t i = 0; i < kJoints; ++i) {
    dynamics.links[i] = parse_link(links[i]);
    dynamics.drives[i] = parse_drive(drives[i], time_step);
  }
  return dynamics;
}

}  // namespace robotcell
