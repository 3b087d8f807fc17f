// Inputs, parameters and outputs of the cell: plain numbers in SI units, independent of FMI and the dynamics
// engine.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "fmu/model/cell_layout.h"
#include "fmu/model/vibration_parameters.h"

namespace robotcell {

constexpr int kJoints = 6;
constexpr int kAxes = kJoints + 1;  // joints of the arm, then the table
constexpr int kTableAxis = kJoints;

/// Deviation of one Denavit-Hartenberg row from nominal; `beta` is Hayati's rotation about y after alpha.
struct DhDeviation {
  double a = 0, d = 0, alpha = 0, theta = 0, beta = 0;
};

/// Wobble of the table axis: at table angle t it is tilted by amplitude * cos(t + phase) about the direction
/// at the angle `direction` in the table's x-y plane.
struct TableWobble {
  double amplitude = 0, phase = 0, direction = 0;  // rad
};

struct TriggerErrors {
  double latency = 0;  // s, delay of the light against the instant that the device records
  double jitter = 0;   // s, standard deviation of that delay
};

/// Deviations of the cell as built from its description. All zero: the nominal cell.
struct AsBuilt {
  std::array<DhDeviation, kJoints> dh{};
  std::array<double, 6> tool{};   // x, y, z (m), rx, ry, rz (rad, intrinsic XYZ): flange_from_sensor * delta
  std::array<double, 5> table{};  // x, y, z (m), rx, ry (rad): world_from_table * delta
  std::array<double, 2> platter{};  // x, y (m) of the platter's centre in the rotating frame
  TableWobble wobble;
  TriggerErrors trigger;
  /// Vibration of the robot base, the flange and the table, each along its own axes.
  VibrationParameters base_vibration, flange_vibration, table_vibration;
};

struct CellParameters {
  std::string cell_file = "cell.json";  // relative to the FMU's resources, or absolute
  std::int32_t seed = 0;
  AsBuilt as_built;
};

enum class TriggerMode : std::int32_t { kOff, kTime, kTableAngle, kPathDistance, kRequest };

struct TriggerCommand {
  std::int32_t mode = 0;
  double period = 0;         // s
  double angle = 0;          // rad
  double distance = 0;       // m
  std::int32_t request = 0;  // every increase fires one exposure
};

struct ConveyorCommand {
  double speed = 0;  // m/s
};

/// Mode, jog frame and operation are those of control/command.h; the variable table bounds all integers.
struct MotionCommand {
  std::int32_t mode = 0;
  std::array<double, kAxes> position{};     // set-points and targets: joints, then table (rad)
  std::array<double, 3> target_position{};  // of the tool in the world, m
  std::array<double, 4> target_orientation{1, 0, 0, 0};
  std::int32_t start = 0;
  double speed = 1, monitor_speed = 1;
  std::array<double, kAxes> jog{};
  std::int32_t jog_frame = 0;
  std::int32_t operation = 1;
  bool emergency_stop = false;
  std::int32_t reset = 0;
  std::int32_t heartbeat = 0;
  double max_age = 0;  // s
};

struct GripperCommandInputs {
  std::int32_t mode = 0;  // 0 keep the last command, 1 width, 2 force
  double width = 0;       // m
  double force = 0;       // N
};

struct CellInputs {
  explicit CellInputs(const CellLayout& layout) : conveyors(layout.conveyors) {}

  MotionCommand motion;
  std::int32_t segment = 0;
  TriggerCommand trigger;
  double exposure = 0;  // s
  PerDevice<ConveyorCommand> conveyors;
  GripperCommandInputs gripper;  // ignored in a cell without gripper
};

/// Pose and twist of a body frame in the world; the velocity is that of the frame origin.
struct BodyState {
  std::array<double, 3> position{};
  std::array<double, 4> orientation{1, 0, 0, 0};  // quaternion w, x, y, z with w >= 0
  std::array<double, 3> velocity{};
  std::array<double, 3> angular_velocity{};
};

/// Poses and twists of all bodies of the cell.
struct Bodies {
  explicit Bodies(const CellLayout& layout) : parts(layout.parts.size()), fingers(layout.gripper ? 2 : 0) {}

  std::array<BodyState, kJoints> links{};
  BodyState sensor, table;
  PerDevice<BodyState> parts, fingers;
};

/// Encoder readings (joints, then table).
struct Measurement {
  std::array<double, kAxes> position{};
  std::array<double, kAxes> rate{};
};

struct Truth {
  explicit Truth(const CellLayout& layout) : bodies(layout) {}

  std::array<double, kAxes> position{};
  Bodies bodies;
};

/// Record of one exposure: encoder readings at its middle, and true poses at the instant of the light.
struct TriggerRecord {
  explicit TriggerRecord(const CellLayout& layout) : truth(layout) {}

  std::int32_t index = 0;  // counted from 1; 0: no record yet
  std::int32_t segment = 0;
  double time = kNoInstant;  // middle of the exposure, s from the start
  double exposure = 0;       // s
  Measurement measured;
  Bodies truth;
};

struct ConveyorOutputs {
  double speed = 0;           // m/s
  double travel = 0;          // m since the start
  double texture_offset = 0;  // travel modulo the belt length, m
};

/// Status of the controller; numbers are those of the enumerations in control/command.h.
struct ControllerOutputs {
  std::int32_t mode = 0, state = 0, error = 0;
  bool moving = false;
  std::int32_t limit = 0;
  double progress = 0;
  bool at_destination = true;
  std::array<double, kAxes> destination{};
};

struct GripperOutputs {
  double width = 0;  // m
  double force = 0;  // N
  bool gripped = false;
  std::array<double, 2> normal_force{};  // N, of each pad on the parts
  std::array<std::array<double, 3>, 2>
      contact_force{};  // N, of each pad on the parts, friction included, world axes
};

/// Bodies are numbered in the order of the description, from 1; 0: none.
struct CollisionReading {
  std::int32_t pairs = 0;  // number of colliding pairs
  std::int32_t body_a = 0, body_b = 0;
  double depth = 0;               // m, of the deepest collision
  std::array<double, 3> point{};  // m, world
  double clearance = 0;           // m, smallest distance; the range where all distances exceed it
  std::int32_t near_a = 0, near_b = 0;
  std::array<std::int32_t, 2> near_faces{};  // internal: closest faces, from which the next search starts
};

/// Latest readings of all sensors and of the collision monitor.
struct Readings {
  explicit Readings(const CellLayout& layout) : sensors(make_readings(layout.sensors)) {}

  SensorReadings sensors;
  CollisionReading collision;
};

struct CellOutputs {
  explicit CellOutputs(const CellLayout& layout)
      : truth(layout), trigger(layout), conveyors(layout.conveyors), readings(layout) {}

  Measurement measured;
  Truth truth;
  std::int32_t trigger_count = 0;
  std::int32_t trigger_queued = 0;
  TriggerRecord trigger;
  ControllerOutputs controller;
  std::array<double, kJoints> motor_torque{};  // N m, with dynamic drives
  PerDevice<ConveyorOutputs> conveyors;
  GripperOutputs gripper;
  Readings readings;
  std::int32_t solver_fallbacks = 0;  // contact problems that were not solved as intended
};

}  // namespace robotcell
