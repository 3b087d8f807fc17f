// The groups of variables that make up the table, one source file for each.
#pragma once

#include "fmu/fmi/table_builder.h"

namespace robotcell::fmi {

/// Returns what initial values depend on.
Dependencies add_parameters(TableBuilder& table, const CellLayout& layout, CellParameters& parameters);
void add_commands(TableBuilder& table, CellInputs& in);
void add_motion_commands(TableBuilder& table, MotionCommand& motion);
void add_controller(TableBuilder& table, ControllerOutputs& controller, const Dependencies& known);
/// Of dynamic drives.
void add_motor_torques(TableBuilder& table, CellOutputs& out, const Dependencies& known);
void add_outputs(TableBuilder& table, CellOutputs& out, const Dependencies& known);
/// Inputs and outputs of the conveyors.
void add_conveyors(TableBuilder& table, CellInputs& in, CellOutputs& out);
/// Inputs and outputs of the gripper.
void add_gripper(TableBuilder& table, GripperCommandInputs& in, GripperOutputs& out,
                 const Dependencies& known);
/// Outputs of presence sensors, distance sensors and the collision watch.
void add_sensing(TableBuilder& table, const CellLayout& layout, CellOutputs& out, const Dependencies& known);

}  // namespace robotcell::fmi
