// Inputs and outputs of the robot controller.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

constexpr auto kInput = Causality::kInput;
constexpr auto kOutput = Causality::kOutput;
constexpr auto kDiscrete = Variability::kDiscrete;

constexpr double kMinSpeed = 1e-6;  // fraction of the full speed: a move ends

std::string axis_name(std::size_t axis) {
  return axis == kTableAxis ? "the rotary table" : "joint " + std::to_string(axis + 1);
}

void add_targets(TableBuilder& table, MotionCommand& motion) {
  const std::string streamed =
      ": in mode 1 streamed set-point, reached one controller cycle after it is read; in ";
  for (std::size_t i = 0; i < kJoints; ++i) {
    table.add(indexed("command.q", i), kInput, kDiscrete, kRadian,
              "Angle of " + axis_name(i) + streamed + "mode 2 target of the next move", motion.position[i]);
  }
  table.add("command.table", kInput, kDiscrete, kRadian,
            "Angle of the rotary table, not wrapped" + streamed + "modes 2 and 3 target of the next move",
            motion.position[kTableAxis]);
  for (std::size_t i = 0; i < 3; ++i) {
    table.add(indexed("command.target.position", i), kInput, kDiscrete, kMetre,
              std::string("Target of the next linear move: ") + kAxisNames[i] +
                  " of the sensor origin, world frame, by the nominal geometry of the arm",
              motion.target_position[i]);
  }
  constexpr const char* kParts[] = {"w", "x", "y", "z"};
  for (std::size_t i = 0; i < 4; ++i) {
    table.add(indexed("command.target.orientation", i), kInput, kDiscrete, kNone,
              std::string("Target of the next linear move: ") + kParts[i] +
                  " of the unit quaternion world_from_sensor, by the nominal geometry of the arm",
              motion.target_orientation[i]);
    table.bound(-1, 1);
  }
}

void add_move_commands(TableBuilder& table, MotionCommand& motion) {
  table.add("command.start", kInput, kDiscrete, kNone,
            "Counter: every increase in mode 2 or 3 starts a move to the present target. A running move "
            "first stops on its path",
            motion.start);
  table.add("command.speed", kInput, kDiscrete, kNone,
            "Speed of the next move as a fraction, at most 1: in mode 2 of the axis speed "
            "limits, in mode 3 of the linear and angular speed limits of the tool",
            motion.speed);
  table.bound(kMinSpeed, 1);
  table.add("command.monitor_speed", kInput, kDiscrete, kNone,
            "Speed override of running moves, 0 to 1, without leaving the path; 0 pauses. Streamed "
            "set-points and jogs are not scaled",
            motion.monitor_speed);
  table.bound(0, 1);
}

void add_jog_commands(TableBuilder& table, MotionCommand& motion) {
  constexpr const char* kDirections[] = {"along x", "along y", "along z", "about x", "about y", "about z"};
  for (std::size_t i = 0; i < kAxes; ++i) {
    const std::string cartesian =
        i == kTableAxis ? " (in mode 5, too)" : std::string("; in mode 5 the sensor ") + kDirections[i];
    table.add(
        indexed("command.jog", i), kInput, kDiscrete, kNone,
        "Jog speed as a fraction of the jog speed limit, -1 to 1: in mode 4 " + axis_name(i) + cartesian,
        motion.jog[i]);
    table.bound(-1, 1);
  }
  table.add("command.jog_frame", kInput, kDiscrete, kNone, "Frame of a Cartesian jog: 0 world, 1 sensor",
            motion.jog_frame);
  table.bound(0, 1);
}

void add_safety_commands(TableBuilder& table, MotionCommand& motion) {
  table.add("command.operation", kInput, kDiscrete, kNone,
            "Operation: 0 manual, where only jogs (modes 4 and 5) move the robot; 1 automatic, where modes 1 "
            "to 3 move it and jogs are rejected",
            motion.operation);
  table.bound(0, 1);
  table.add("command.emergency_stop", kInput, kDiscrete, kNone,
            "Emergency stop: true stops all axes as fast as their acceleration limits allow, a move on its "
            "path. Latched until command.reset",
            motion.emergency_stop);
  table.add("command.reset", kInput, kDiscrete, kNone,
            "Counter: every increase clears an emergency stop if command.emergency_stop is false, all axes "
            "are at rest and command.mode is 0. The stopped motion is not resumed",
            motion.reset);
  table.add("command.heartbeat", kInput, kDiscrete, kNone,
            "Watchdog: any change restarts the timeout of command.max_age", motion.heartbeat);
  table.add("command.max_age", kInput, kDiscrete, kSecond,
            "Timeout of the watchdog: without a change of command.heartbeat for this time, set-points and "
            "jogs (modes 1, 4, 5) are rejected and the axes brake; 0 disables it",
            motion.max_age);
  table.bound(0);
}

}  // namespace

void add_motion_commands(TableBuilder& table, MotionCommand& motion) {
  table.add("command.mode", kInput, kDiscrete, kNone,
            "Controller mode: 0 hold (brake and rest), 1 servo (follow streamed set-points), 2 joint move, 3 "
            "linear move of the sensor, 4 joint jog, 5 Cartesian jog of the sensor. Except between modes 0 "
            "and 1, a change waits until the axes are at rest",
            motion.mode);
  table.bound(0, 5);
  add_targets(table, motion);
  add_move_commands(table, motion);
  add_jog_commands(table, motion);
  add_safety_commands(table, motion);
}

void add_controller(TableBuilder& table, ControllerOutputs& controller, const Dependencies& dependencies) {
  table.add("controller.mode", kOutput, kDiscrete, kNone,
            "Active controller mode, numbered as command.mode; 0 while the command is rejected",
            controller.mode);
  table.add("controller.state", kOutput, kDiscrete, kNone,
            "Controller state: 0 at rest, 1 moving as commanded, 2 braking, 3 emergency stop",
            controller.state);
  table.add(
      "controller.error", kOutput, kDiscrete, kNone,
      "Reason for which the command is rejected: 0 none, 1 mode not allowed in manual operation, 2 mode not "
      "allowed in automatic operation, 3 emergency stop, 4 watchdog timeout, 5 target outside the position "
      "limits, 6 path outside the position limits, 7 singularity on the path or target out of reach",
      controller.error);
  table.add("controller.moving", kOutput, kDiscrete, kNone, "True while any axis moves", controller.moving);
  table.add("controller.limit", kOutput, kDiscrete, kNone,
            "First axis at a position or speed limit, or outside it with errors 5 and 6: 1 to 6 joint, 7 "
            "table, 0 none",
            controller.limit);
  table.add("controller.progress", kOutput, kDiscrete, kNone,
            "Completed fraction of the path of the running or last move, 0 to 1", controller.progress);
  table.bound(0, 1);
  table.add("controller.at_destination", kOutput, kDiscrete, kNone,
            "True while all axes are at rest exactly at controller.destination", controller.at_destination);
  for (std::size_t i = 0; i < kJoints; ++i) {
    table.add(indexed("controller.destination.q", i), kOutput, kDiscrete, kRadian,
              "Target of the running or last motion: angle of joint " + std::to_string(i + 1),
              controller.destination[i], dependencies.file);
  }
  table.add("controller.destination.table", kOutput, kDiscrete, kRadian,
            "Target of the running or last motion: angle of the table", controller.destination[kTableAxis],
            dependencies.file);
}

}  // namespace robotcell::fmi
