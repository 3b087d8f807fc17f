// Connection between cell and controller: geometry, settings, commands, reports.
#pragma once

#include <string>

#include "fmu/control/robot_controller.h"
#include "fmu/model/description/cell_description.h"
#include "fmu/model/world/kinematics.h"

namespace robotcell {

/// Nominal kinematics of the arm with the sensor as its tool, for the controller.
class NominalArm : public control::ArmGeometry {
 public:
  explicit NominalArm(const CellDescription& cell);
  control::ToolState tool(const control::Axes& position) const override;
  const std::vector<int>& cartesian_joints() const override { return cartesian_joints_; }

 private:
  Kinematics kinematics_;
  std::vector<int> cartesian_joints_;
};

control::ControllerSettings settings_of(const CellDescription& cell);

/// Without a pose where the target orientation is no unit quaternion.
control::Command command_of(const MotionCommand& motion);

/// Outputs for an arm with this number of joints in a simulation from `start_time` (s) on.
ControllerOutputs outputs_of(const control::Report& report, std::size_t joints, double start_time);

/// What the pendant shows: messages of the controller precede the commanded one. `refusal` is why the command
/// is not executed; empty: it is.
PendantOutputs pendant_of(const control::Report& report, const std::string& refusal,
                          const PendantCommand& command);

}  // namespace robotcell
