// The controller as a device of the cell: its inputs and outputs, and its connection to the cell.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "fmu/control/robot_controller.h"
#include "fmu/model/description/value_limits.h"
#include "fmu/model/fields.h"
#include "fmu/model/world/kinematics.h"

namespace robotcell {

constexpr double kMaxGuardTime = 5e9;  // s: beyond the largest simulation time
constexpr double kMinSpeed = 1e-6;     // fraction of the full speed: a move ends

constexpr Element kJogElements[kMaxJoints + 2] = {
    {"[1]", "joint 1; in mode 5 the tool along x"},
    {"[2]", "joint 2; in mode 5 the tool along y"},
    {"[3]", "joint 3; in mode 5 the tool along z"},
    {"[4]", "joint 4; in mode 5 the tool about x"},
    {"[5]", "joint 5; in mode 5 the tool about y"},
    {"[6]", "joint 6; in mode 5 the tool about z"},
    {"[7]", "joint 7"},
    {"[8]", "joint 8"},
    {"[{t}]", "the rotary table, in mode 5, too"},
    {"[{n}]", "the axis {a}"},
};

/// Mode, jog frame and operation are those of control/command.h.
struct MotionCommand {
  std::int32_t mode = 0;
  std::string program;                    // path of a file, relative to the FMU's resources, or absolute
  std::array<double, kAxes> position{};   // set-points and targets of the axes, rad or m
  std::array<double, 3> tool_position{};  // on the flange, m
  std::array<double, 4> tool_orientation{1, 0, 0, 0};
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
  double max_age = 0;        // s
  double guard_time = 0;     // s, simulation time
  double guard_max_age = 0;  // s

  template <class Visitor>
  static void declare(Visitor& visit, MotionCommand& c) {
    visit(
        c,
        choice_field<control::Mode>(
            c.mode,
            {"mode", kNone,
             "Controller mode. Except between modes 0 and 1, a change waits until the axes are at rest"}),
        field(
            c.program,
            {"program", kNone,
             "File of the program for mode 6: a saved plan (JSON), absolute or relative to the resources of "
             "the FMU. It is read when a segment is started for the first time after this path changed"}),
        field(c.position,
              with_axes({"", kRadian,
                         "Angle of {e}: in mode 1 streamed set-point, reached one controller cycle "
                         "after it is read; in mode 2 (the table: and 3) target of the next move"},
                        kAxisElements)),
        field(c.tool_position,
              bounded({"tool.position[{i}]", kMetre,
                       "Tool of linear moves and jogs: {x} of its origin in the frame of the flange; at the "
                       "start the sensor. Read when a linear move starts and, at rest, when a jog starts: a "
                       "change during a jog first brings the axes to rest"},
                      -kMaxCoordinate, kMaxCoordinate)),
        field(
            c.tool_orientation,
            bounded({"tool.orientation[{i}]", kNone,
                     "Tool of linear moves and jogs: {x} of the unit quaternion flange_from_tool; scaled to "
                     "unit length where its norm is from 0.99 to 1.01"},
                    -1, 1)),
        field(c.target_position,
              {"target.position[{i}]", kMetre,
               "Target of the next linear move: {x} of the origin of the tool, world frame, by the nominal "
               "geometry of the arm"}),
        field(c.target_orientation,
              bounded({"target.orientation[{i}]", kNone,
                       "Target of the next linear move: {x} of the unit quaternion world_from_tool, by "
                       "the nominal geometry of the arm; scaled to unit length where its norm is from "
                       "0.99 to 1.01"},
                      -1, 1)),
        field(c.start,
              {"start", kNone,
               "Counter: every increase in mode 2 or 3 starts a move to the present target, in mode 6 the "
               "segment command.segment of the program. A running motion first stops on its path"}),
        field(
            c.speed,
            bounded({"speed", kNone,
                     "Speed of the next move as a fraction, at most 1: in mode 2 of the axis speed limits, "
                     "in mode 3 of the linear and angular speed limits of the tool and of that of the table"},
                    kMinSpeed, 1)),
        field(
            c.monitor_speed,
            bounded(
                {"monitor_speed", kNone,
                 "Speed override of moves and segments, 0 to 1, while they run, without leaving the path; 0 "
                 "pauses. Streamed set-points are not scaled. With a guard, largest jog speed as a fraction "
                 "of "
                 "the full speed in the direction of the jog; without one, jogs are not scaled"},
                0, 1)),
        field(c.jog,
              with_axes(bounded({"jog", kNone,
                                 "Jog speed as a fraction of the jog speed limit, -1 to 1: in mode 4 {e}"},
                                -1, 1),
                        kJogElements)),
        choice_field<control::JogFrame>(c.jog_frame, {"jog_frame", kNone, "Frame of a Cartesian jog"}),
        choice_field<control::Operation>(c.operation, {"operation", kNone, "Operation"}),
        field(c.emergency_stop,
              {"emergency_stop", kNone,
               "Emergency stop: true stops all axes as fast as their acceleration limits allow, a "
               "move or segment on its path. Latched until command.reset"}),
        field(
            c.reset,
            {"reset", kNone,
             "Counter: every increase clears an emergency stop if command.emergency_stop is false, all axes "
             "are at rest and command.mode is 0; the stopped motion is not resumed. It also lets a move or "
             "segment "
             "go on that the guard has stopped, if command.guard.time is not too old"}),
        field(c.heartbeat,
              {"heartbeat", kNone, "Watchdog: any change restarts the timeout of command.max_age"}),
        field(c.max_age,
              bounded({"max_age", kSecond,
                       "Timeout of the watchdog: without a change of command.heartbeat for this time, "
                       "set-points and jogs (modes 1, 4, 5) are rejected and the axes brake; 0 disables it"},
                      0)),
        field(
            c.guard_time,
            bounded({"guard.time", kSecond,
                     "Simulation time of the state of the robot that the last message of the guard answers. "
                     "Times in the future, and earlier ones than the latest so far, are ignored; 0: no "
                     "message yet"},
                    -kMaxGuardTime, kMaxGuardTime)),
        field(c.guard_max_age,
              bounded(
                  {"guard.max_age", kSecond,
                   "Largest allowed age of command.guard.time. Moves, segments and jogs wait at their start "
                   "until command.guard.time is after controller.path_time; then jogs are limited to "
                   "command.monitor_speed. Moves and segments slow down from full speed at half this age to "
                   "rest at this age and wait on their paths for an increase of command.reset; older, "
                   "set-points and jogs (modes 1, 4, 5) end in an emergency stop; 0: no guard"},
                  0)));
  }
};

/// Message for the operator at the pendant.
struct PendantCommand {
  std::string text;
  bool beep = false;

  template <class Visitor>
  static void declare(Visitor& visit, PendantCommand& c) {
    visit(c,
          field(c.text,
                {"text", kNone,
                 "Text for the pendant from the next communication step on, shown while the "
                 "controller has no message of its own; after 'stop: ' the reason of an emergency stop"}),
          field(c.beep, {"beep", kNone, "True: the pendant beeps"}));
  }
};

constexpr Element kDestinationElements[] = {
    {"q[{i}]", "angle of joint {i}"}, {"table", "angle of the table"}, {"axis.{a}", "angle of the axis {a}"}};

/// Status of the controller.
struct ControllerOutputs {
  std::int32_t mode = 0, state = 0, error = 0;
  bool moving = false;
  std::int32_t limit = 0;
  double progress = 0;
  double clock = 0;  // s
  double rate = 0;
  bool at_destination = true;
  std::array<double, kAxes> destination{};
  double guard_age = 0;  // s
  double path_time = 0;  // s

  template <class Visitor>
  static void declare(Visitor& visit, ControllerOutputs& o) {
    visit(
        o,
        choice_field<control::Mode>(
            o.mode, {"mode", kNone, "Active controller mode; hold while the command is rejected"}),
        choice_field<control::Phase>(o.state, {"state", kNone, "Controller state"}),
        choice_field<control::ControllerError>(o.error,
                                               {"error", kNone, "Reason for which the command is rejected"}),
        field(o.moving, {"moving", kNone, "True while any axis moves"}),
        field(o.limit,
              axis_number({"limit", kNone,
                           "First axis at a limit of position, speed or (in mode 1) acceleration, or "
                           "the one that errors 5, 6, 9 and 10 are about: a joint by its number, {t} the "
                           "table, 0 none"})),
        field(o.progress,
              bounded({"progress", kNone,
                       "Completed fraction of the path of the running or last move or segment, 0 to 1"},
                      0, 1)),
        field(o.clock,
              bounded(continuous({"clock", kSecond,
                                  "Path clock of the running or last move or segment: time from its start at "
                                  "full monitor speed"}),
                      0)),
        field(
            o.rate,
            bounded({"rate", kNone,
                     "Rate of the path clock against time, 0 to 1: the speed of the running move, segment or "
                     "jog as a fraction of that of controller.ahead; 0 where none runs"},
                    0, 1)),
        field(o.at_destination,
              {"at_destination", kNone, "True while all axes are at rest exactly at controller.destination"}),
        field(o.destination,
              with_axes(initially(Initial::kDescription,
                                  {"destination.", kRadian, "Target of the running or last motion: {e}"}),
                        kDestinationElements)),
        field(o.guard_age, bounded(continuous({"guard.age", kSecond,
                                               "Age of the latest state of the robot that a message of the "
                                               "guard has answered (command.guard.time)"}),
                                   0)),
        field(
            o.path_time,
            {"path_time", kSecond,
             "Simulation time at which the controller took up the running or last move, segment or jog: from "
             "then on controller.ahead shows its path. With a guard it waits for a later "
             "command.guard.time"}));
  }
};

/// What the pendant shows.
struct PendantOutputs {
  std::string text;
  bool beep = false;

  template <class Visitor>
  static void declare(Visitor& visit, PendantOutputs& o) {
    visit(
        o,
        field(
            o.text,
            {"text", kNone,
             "Text on the pendant: why the controller stops, waits, slows down or rejects its command, else "
             "command.pendant.text"}),
        field(o.beep,
              {"beep", kNone,
               "True while the pendant beeps: command.pendant.beep, or the guard has stopped the robot"}));
  }
};

/// Nominal kinematics of the arm, for the controller.
class NominalArm : public control::ArmKinematics {
 public:
  explicit NominalArm(const CellDescription& cell);
  control::ToolState tool(const control::Axes& position,
                          const Eigen::Isometry3d& flange_from_tool) const override;
  const std::vector<int>& cartesian_joints() const override { return cartesian_joints_; }

 private:
  Kinematics kinematics_;
  std::vector<int> cartesian_joints_;
};

control::ControllerSettings settings_of(const CellDescription& cell);

/// Without a pose or tool where its orientation is no unit quaternion. A tool that differs from
/// `flange_from_usual_tool` by rounding alone is exactly that.
control::Command command_of(const MotionCommand& motion, const Eigen::Isometry3d& flange_from_usual_tool);

/// Outputs for an arm with this number of joints in a simulation from `start_time` (s) on.
ControllerOutputs outputs_of(const control::Report& report, std::size_t joints, double start_time);

/// What the pendant shows: messages of the controller precede the commanded one. `refusal` is why the command
/// is not executed; empty: it is.
PendantOutputs pendant_of(const control::Report& report, const std::string& refusal,
                          const PendantCommand& command);

}  // namespace robotcell
