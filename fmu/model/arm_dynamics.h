// Description and state of an arm with dynamic drives.
#pragma once

#include <array>

#include "fmu/model/cell_values.h"
#include "fmu/model/json_reader.h"
#include "fmu/model/motor.h"
#include "fmu/model/rigid_inertia.h"

namespace robotcell {

struct ArmDynamicsDescription {
  std::array<RigidInertia, kJoints> links;  // in the link frames
  std::array<DriveDescription, kJoints> drives;
};

/// `time_step` (s) limits the stiffness of the gears. Throws DescriptionError.
ArmDynamicsDescription parse_arm_dynamics(const JsonReader& json, double time_step);

struct ArmDynamicsState {
  std::array<double, kJoints> position{}, rate{};  // of the links, rad, rad/s
  std::array<double, kJoints> gear_torque{};       // acting on the links, N m
  std::array<MotorState, kJoints> motors{};
};

}  // namespace robotcell
