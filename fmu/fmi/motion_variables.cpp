// Inputs and outputs of the robot controller.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

constexpr auto kInput = Causality::kInput;
constexpr auto kOutput = Causality::kOutput;
constexpr auto kDiscrete = Variability::kDiscrete;

std::string axis_name(std::size_t axis) {
  return axis == kTableAxis ? "the rotary table" : "joint " + std::to_string(axis + 1);
}

void add_targets(TableBuilder& table, MotionCommand& motion) {
  const char* taken =
      ": in mode 1 the controller takes it at its next cycle and reaches it one cycle later, in modes 2 and "
      "3 "
      "it is where the next move leads";
  for (std::size_t i = 0; i < kJoints; ++i) {
    table.add(indexed("command.q", i), kInput, kDiscrete, kRadian,
              "Set-point of " + axis_name(i) + taken + " (of the joints in mode 2 alone)",
              motion.position[i]);
  }
  table.add("command.table", kInput, kDiscrete, kRadian, std::string("Set-point of the rotary table") + taken,
            motion.position[kTableAxis]);
  for (std::size_t i = 0; i < 3; ++i) {
    table.add(indexed("command.target.position", i), kInput, kDiscrete, kMetre,
              std::string("Where the next straight line leads: ") + kAxisNames[i] +
                  " of the sensor's origin in the world, by the arm's nominal geometry",
              motion.target_position[i]);
  }
  constexpr const char* kParts[] = {"w", "x", "y", "z"};
  for (std::size_t i = 0; i < 4; ++i) {
    table.add(indexed("command.target.orientation", i), kInput, kDiscrete, kNone,
              std::string("Where the next straight line leads: orientation of the sensor in the world, ") +
                  kParts[i] + " of the unit quaternion",
              motion.target_orientation[i]);
  }
}

void add_move_commands(TableBuilder& table, MotionCommand& motion) {
  table.add("command.start", kInput, kDiscrete, kNone,
            "Every increase, in mode 2 or 3, starts a move to the present target from where the axes rest; a "
            "move under way stops on its path first",
            motion.start);
  table.add("command.speed", kInput, kDiscrete, kNone,
            "Share of the full speed with which the next move goes, above 0, at most 1: of the slowest axis' "
            "greatest speed in mode 2, of the line speed of the description in mode 3",
            motion.speed);
  table.add("command.monitor_speed", kInput, kDiscrete, kNone,
            "Share, 0 to 1, by which moves are slowed down while they go, without leaving their path; 0 "
            "pauses. Streamed set-points and jogs are not scaled",
            motion.monitor_speed);
}

void add_jog_commands(TableBuilder& table, MotionCommand& motion) {
  constexpr const char* kDirections[] = {"along x", "along y", "along z", "about x", "about y", "about z"};
  for (std::size_t i = 0; i < kAxes; ++i) {
    const std::string cartesian =
        i == kTableAxis ? ", in mode 5 too" : std::string(", in mode 5 the sensor ") + kDirections[i];
    table.add(indexed("command.jog", i), kInput, kDiscrete, kNone,
              "Speed of a jog, -1 to 1 of the speed that the description allows by hand: in mode 4 " +
                  axis_name(i) + cartesian,
              motion.jog[i]);
  }
  table.add("command.jog_frame", kInput, kDiscrete, kNone,
            "Axes of a Cartesian jog: 0 the world's, 1 the sensor's own", motion.jog_frame);
  table.limit_integer(0, 1);
}

void add_safety_commands(TableBuilder& table, MotionCommand& motion) {
  table.add("command.operation", kInput, kDiscrete, kNone,
            "0 manual: jogs alone move the robot, no program does or changes its speed. 1 automatic: a "
            "program moves it (modes 1 to 3), jogs are refused",
            motion.operation);
  table.limit_integer(0, 1);
  table.add("command.emergency_stop", kInput, kDiscrete, kNone,
            "Stops all axes as fast as their acceleration limits allow, a move on its path; stays in force "
            "until command.reset",
            motion.emergency_stop);
  table.add(
      "command.reset", kInput, kDiscrete, kNone,
      "Every increase ends an emergency stop, if the button is released, all axes rest and command.mode "
      "is 0; what was stopped does not go on",
      motion.reset);
  table.add("command.heartbeat", kInput, kDiscrete, kNone,
            "Any change shows that the sender of set-points or jogs lives; see command.max_age",
            motion.heartbeat);
  table.add(
      "command.max_age", kInput, kDiscrete, kSecond,
      "Time without a heartbeat after which set-points and jogs (modes 1, 4, 5) are too old and the axes "
      "brake; 0: never",
      motion.max_age);
}

}  // namespace

void add_motion_commands(TableBuilder& table, MotionCommand& motion) {
  table.add(
      "command.mode", kInput, kDiscrete, kNone,
      "What the controller does: 0 brake and hold, 1 follow the set-points, 2 move the joints to their "
      "set-points, 3 move the sensor straight to its target, 4 jog axes, 5 jog the sensor. Between other "
      "modes than 0 and 1 the axes come to rest first",
      motion.mode);
  table.limit_integer(0, 5);
  add_targets(table, motion);
  add_move_commands(table, motion);
  add_jog_commands(table, motion);
  add_safety_commands(table, motion);
}

void add_controller(TableBuilder& table, ControllerOutputs& controller, const Dependencies& known) {
  table.add("controller.mode", kOutput, kDiscrete, kNone,
            "Mode in force; numbers of command.mode. It is 0 where the command is refused", controller.mode);
  table.add("controller.state", kOutput, kDiscrete, kNone,
            "0 at rest, 1 moving as commanded, 2 braking, 3 emergency stop", controller.state);
  table.add(
      "controller.error", kOutput, kDiscrete, kNone,
      "Why the command is not carried out: 0 it is, 1 not in manual operation, 2 not in automatic "
      "operation, 3 emergency stop, 4 no heartbeat, 5 target outside the limits, 6 a limit on the way, 7 "
      "a singular position on the way or target out of reach",
      controller.error);
  table.add("controller.moving", kOutput, kDiscrete, kNone, "Whether any axis is in motion",
            controller.moving);
  table.add("controller.limit", kOutput, kDiscrete, kNone,
            "First axis that a position or speed limit keeps from its set-point, or the axis of errors 5 and "
            "6: 1 to 6 joint, 7 table, 0 none",
            controller.limit);
  table.add("controller.progress", kOutput, kDiscrete, kNone,
            "Share of the last move's path that is done, 0 to 1", controller.progress);
  table.add("controller.at_destination", kOutput, kDiscrete, kNone,
            "Whether all axes rest exactly at controller.destination", controller.at_destination);
  for (std::size_t i = 0; i < kJoints; ++i) {
    table.add(indexed("controller.destination.q", i), kOutput, kDiscrete, kRadian,
              "Where the motion in force, or the last one, leads: angle of joint " + std::to_string(i + 1),
              controller.destination[i], known.file);
  }
  table.add("controller.destination.table", kOutput, kDiscrete, kRadian,
            "Where the motion in force, or the last one, leads: angle of the table",
            controller.destination[kTableAxis], known.file);
}

}  // namespace robotcell::fmi
