// What a dynamic arm is made of, and what it remembers.
#pragma once

#include <Eigen/Core>
#include <array>

#include "fmu/model/cell_values.h"
#include "fmu/model/json_reader.h"
#include "fmu/model/motor.h"

namespace robotcell {

struct LinkInertia {
  double mass = 0;                                           // kg
  Eigen::Vector3d centre_of_mass = Eigen::Vector3d::Zero();  // link frame, m
  Eigen::Matrix3d inertia = Eigen::Matrix3d::Zero();         // about the centre of mass, kg m^2
};

struct ArmDynamicsDescription {
  std::array<LinkInertia, kJoints> links;
  std::array<DriveDescription, kJoints> drives;
};

/// `time_step` (s) bounds how stiff a gear may be. Throws DescriptionError.
ArmDynamicsDescription parse_arm_dynamics(const JsonReader& json, double time_step);

struct ArmDynamicsState {
  std::array<double, kJoints> position{}, rate{};  // of the links, rad and rad/s
  std::array<double, kJoints> gear_torque{};       // on the links, N m
  std::array<MotorState, kJoints> motors{};
};

}  // namespace robotcell
