// Groups of variables in the table.
#pragma once

#include "fmu/fmi/table_builder.h"

namespace robotcell::fmi {

/// Returns the parameters on which initial values depend.
Dependencies add_parameters(TableBuilder& table, const CellLayout& layout, CellParameters& parameters);
/// Commands to controller and trigger; `prefix` begins their names.
void add_commands(TableBuilder& table, CellInputs& in, const std::string& prefix = "command.",
                  Causality causality = Causality::kInput);
/// Motor torques of dynamic drives.
void add_motor_torques(TableBuilder& table, CellOutputs& out, const Dependencies& dependencies);
void add_outputs(TableBuilder& table, CellOutputs& out, const Dependencies& dependencies);
/// Axes on the path ahead of the controller: joints and table at each point.
void add_path_ahead(TableBuilder& table, PerDevice<double>& ahead, PathAheadVariables variables,
                    const Dependencies& dependencies);
/// Arrays of all numbers of the records, and the number of the last records.
std::vector<RecordColumn> add_records(TableBuilder& table, std::int32_t& count);
/// Commands to the conveyors; `prefix` begins their names.
void add_conveyor_commands(TableBuilder& table, CellInputs& in, const std::string& prefix = "command.",
                           Causality causality = Causality::kInput);
/// Inputs and outputs of the conveyors.
void add_conveyors(TableBuilder& table, CellInputs& in, CellOutputs& out);
/// Inputs and outputs of the gripper.
void add_gripper(TableBuilder& table, GripperCommand& in, GripperOutputs& out,
                 const Dependencies& dependencies);
/// Outputs of the sensors and the collision monitor.
void add_sensing(TableBuilder& table, const CellLayout& layout, CellOutputs& out,
                 const Dependencies& dependencies);

}  // namespace robotcell::fmi
