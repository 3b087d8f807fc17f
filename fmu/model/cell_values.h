// Inputs, parameters and outputs of the cell: plain numbers in SI units, independent of FMI and the dynamics
// engine. Each device declares its own.
#pragma once

#include <cstdint>
#include <string>

#include "fmu/model/as_built.h"
#include "fmu/model/bodies.h"
#include "fmu/model/devices/belt.h"
#include "fmu/model/devices/collision_reading.h"
#include "fmu/model/devices/controller.h"
#include "fmu/model/devices/encoder.h"
#include "fmu/model/devices/gripper.h"
#include "fmu/model/devices/trigger.h"

namespace robotcell {

struct CellParameters {
  std::string cell_file = "cell.json";  // relative to the FMU's resources, or absolute
  std::int32_t seed = 0;
  AsBuilt as_built;
};

struct CellInputs {
  explicit CellInputs(const CellLayout& layout) : conveyors(layout.conveyors) {}

  MotionCommand motion;
  std::int32_t segment = 0;
  TriggerCommand trigger;
  double exposure = 0;  // s
  PerDevice<ConveyorCommand> conveyors;
  GripperCommand gripper;  // ignored in a cell without gripper
  PendantCommand pendant;
};

struct Truth {
  explicit Truth(const CellLayout& layout) : bodies(layout) {}

  std::array<double, kAxes> position{};
  Bodies bodies;
};

/// Latest readings of all sensors and of the collision monitor.
struct Readings {
  explicit Readings(const CellLayout& layout) : sensors(make_readings(layout.sensors)) {}

  SensorReadings sensors;
  CollisionReading collision;
};

struct CellOutputs {
  explicit CellOutputs(const CellLayout& layout)
      : truth(layout),
        trigger(layout),
        conveyors(layout.conveyors),
        belt_readings(layout.conveyors),
        readings(layout) {}

  Measurement measured;
  Truth truth;
  std::int32_t trigger_count = 0;
  std::int32_t trigger_queued = 0;
  TriggerRecord trigger;
  ControllerOutputs controller;
  control::PathAhead ahead{};  // written on demand
  PendantOutputs pendant;
  std::array<double, kMaxJoints> motor_torque{};  // N m, with dynamic drives
  PerDevice<ConveyorOutputs> conveyors;
  PerDevice<BeltReading> belt_readings;
  GripperOutputs gripper;
  Readings readings;
  std::int32_t solver_fallbacks = 0;    // contact problems that were not solved as intended
  std::int32_t truncated_contacts = 0;  // pairs of bodies whose contacts were lost in part
};

}  // namespace robotcell
