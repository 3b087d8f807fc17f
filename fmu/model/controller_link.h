// What connects the cell to its controller: geometry, settings, commands, reports.
#pragma once

#include "fmu/control/robot_controller.h"
#include "fmu/model/cell_description.h"
#include "fmu/model/kinematics.h"

namespace robotcell {

/// The arm by its nominal geometry, its tool the sensor: what the controller believes.
class NominalArm : public control::ArmGeometry {
 public:
  explicit NominalArm(const CellDescription& cell) : kinematics_(cell, AsBuilt{}) {}
  control::ToolState tool(const control::Axes& position) const override;

 private:
  Kinematics kinematics_;
};

control::ControllerSettings settings_of(const CellDescription& cell);

/// Throws std::invalid_argument where a command makes no sense.
control::Command command_of(const MotionCommand& motion);

ControllerOutputs outputs_of(const control::Report& report);

}  // namespace robotcell
