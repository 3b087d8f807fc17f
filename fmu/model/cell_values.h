// What goes into and comes out of the cell. Plain numbers in SI units; knows neither FMI nor the dynamics
// engine.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "fmu/model/cell_layout.h"
#include "fmu/model/vibration_parameters.h"

namespace robotcell {

constexpr int kJoints = 6;
constexpr int kAxes = kJoints + 1;  // the arm's joints, then the table
constexpr int kTableAxis = kJoints;

/// Deviation of one Denavit-Hartenberg row from nominal; `beta` is Hayati's turn about y after the row's
/// alpha.
struct DhDeviation {
  double a = 0, d = 0, alpha = 0, theta = 0, beta = 0;
};

/// The table's axis swings in a plane, once per turn: at table angle t it is tilted by
/// amplitude * cos(t + phase) about the axis that lies at the angle `direction` in the table's x-y plane.
struct TableWobble {
  double amplitude = 0, phase = 0, direction = 0;  // rad
};

struct TriggerErrors {
  double latency = 0;  // s from the instant that the device believes to the instant of the light
  double jitter = 0;   // standard deviation of that delay, s
};

/// How the cell as built differs from its drawing. All zero: the nominal cell.
struct AsBuilt {
  std::array<DhDeviation, kJoints> dh{};
  std::array<double, 6> tool{};   // x, y, z (m), rx, ry, rz (rad, intrinsic XYZ): flange_from_sensor * delta
  std::array<double, 5> table{};  // x, y, z (m), rx, ry (rad): world_from_table * delta
  std::array<double, 2> platter{};  // x, y (m) of the platter's centre in the turning frame
  TableWobble wobble;
  TriggerErrors trigger;
  /// Shakes the robot's base, its flange, or the table, along their own axes.
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
  std::int32_t request = 0;  // every increase fires once
};

struct ConveyorCommand {
  double speed = 0;  // m/s
};

/// Modes 0 to 5 are those of the controller.
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
  std::int32_t mode = 0;  // 0 keep, 1 width, 2 force
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
  GripperCommandInputs gripper;  // of no effect in a cell without one
};

/// Pose of a body's frame in the world; velocity is that of the frame's origin.
struct BodyState {
  std::array<double, 3> position{};
  std::array<double, 4> orientation{1, 0, 0, 0};  // quaternion w, x, y, z with w >= 0
  std::array<double, 3> velocity{};
  std::array<double, 3> angular_velocity{};
};

/// The bodies whose pose and twist the cell reports.
struct Bodies {
  explicit Bodies(const CellLayout& layout) : parts(layout.parts.size()), fingers(layout.gripper ? 2 : 0) {}

  std::array<BodyState, kJoints> links{};
  BodyState sensor, table;
  PerDevice<BodyState> parts, fingers;
};

/// What the encoders say (joints, then table).
struct Measurement {
  std::array<double, kAxes> position{};
  std::array<double, kAxes> rate{};
};

struct Truth {
  explicit Truth(const CellLayout& layout) : bodies(layout) {}

  std::array<double, kAxes> position{};
  Bodies bodies;
};

/// One exposure: what was measured in its middle, and what was true when the light came.
struct TriggerRecord {
  explicit TriggerRecord(const CellLayout& layout) : truth(layout) {}

  std::int32_t index = 0;  // counts from 1; 0: no record yet
  std::int32_t segment = 0;
  double time = 0;      // middle of the exposure, s
  double exposure = 0;  // s
  Measurement measured;
  Bodies truth;
};

struct ConveyorOutputs {
  double speed = 0;           // m/s
  double travel = 0;          // m since the start
  double texture_offset = 0;  // travel within one length of the belt, m
};

/// What the controller says of itself; the numbers are those of its enumerations.
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
  std::array<double, 2> normal_force{};                  // of each pad on parts, N
  std::array<std::array<double, 3>, 2> contact_force{};  // the same with friction, world, N
};

struct PresenceReading {
  bool detected = false;
};

struct DistanceReading {
  bool valid = false;
  double distance = 0;  // m; 0 where it is not valid
  double time = 0;      // s, of the measurement
};

/// Bodies by their number in the description, counted from 1; 0: none.
struct CollisionReading {
  std::int32_t pairs = 0;  // that collide
  std::int32_t body_a = 0, body_b = 0;
  double depth = 0;               // m, of the deepest
  std::array<double, 3> point{};  // world, m
  double clearance = 0;           // m: smallest distance, or the range where all are beyond it
  std::int32_t near_a = 0, near_b = 0;
  std::array<std::int32_t, 2> near_faces{};  // no output: where the next search begins
};

struct CellOutputs {
  explicit CellOutputs(const CellLayout& layout)
      : truth(layout),
        trigger(layout),
        conveyors(layout.conveyors),
        presence(layout.presence_sensors),
        distance(layout.distance_sensors) {}

  Measurement measured;
  Truth truth;
  std::int32_t trigger_count = 0;
  std::int32_t trigger_queued = 0;
  TriggerRecord trigger;
  ControllerOutputs controller;
  std::array<double, kJoints> motor_torque{};  // N m, of dynamic drives
  PerDevice<ConveyorOutputs> conveyors;
  GripperOutputs gripper;
  PerDevice<PresenceReading> presence;
  PerDevice<DistanceReading> distance;
  CollisionReading collision;
};

}  // namespace robotcell
