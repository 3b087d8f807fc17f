// Description and state of an arm with dynamic drives.
#pragma once

#include <array>
#include <vector>

#include "fmu/model/cell_values.h"
#include "fmu/model/description/json_reader.h"
#include "fmu/model/description/rigid_inertia.h"
#include "fmu/model/devices/motor.h"

namespace robotcell {

struct ArmDynamicsDescription {
  std::vector<RigidInertia> links;  // in the link frames
  std::vector<DriveDescription> drives;
};

/// `time_step` (s) limits the stiffness of the gears. Throws DescriptionError.
ArmDynamicsDescription parse_arm_dynamics(const JsonReader& json, std::size_t joints, double time_step);

struct ArmDynamicsState {
  std::array<double, kMaxJoints> position{}, rate{};  // of the links, rad, rad/s
  std::array<double, kMaxJoints> gear_torque{};       // acting on the links, N m
  std::array<MotorState, kMaxJoints> motors{};
};

}  // namespace robotcell
