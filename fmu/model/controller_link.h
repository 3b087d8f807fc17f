// Connection between cell and controller: geometry, settings, commands, reports.
#pragma once

#include "fmu/control/robot_controller.h"
#include "fmu/model/cell_description.h"
#include "fmu/model/kinematics.h"

namespace robotcell {

/// Nominal kinematics of the arm with the sensor as its tool, for the controller.
class NominalArm : public control::ArmGeometry {
 public:
  explicit NominalArm(const CellDescription& cell) : kinematics_(cell, AsBuilt{}) {}
  control::ToolState tool(const control::Axes& position) const override;

 private:
  Kinematics kinematics_;
};

control::ControllerSettings settings_of(const CellDescription& cell);

/// Throws std::invalid_argument for an invalid command.
control::Command command_of(const MotionCommand& motion);

ControllerOutputs outputs_of(const control::Report& report);

}  // namespace robotcell
