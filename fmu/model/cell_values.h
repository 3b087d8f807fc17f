// Inputs, parameters and outputs of the cell: plain numbers in SI units, independent of FMI and the dynamics
// engine.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "fmu/control/robot_controller.h"
#include "fmu/model/cell_layout.h"
#include "fmu/model/devices/gripper_state.h"
#include "fmu/model/fields.h"
#include "fmu/model/vibration_parameters.h"

namespace robotcell {

using control::kAxes;
using control::kMaxJoints;
using control::kTableAxis;

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

  template <class Visitor>
  static void declare(Visitor& visit, TriggerErrors& e) {
    visit(
        e,
        field(
            e.latency,
            bounded(
                {"latency", kSecond,
                 "Deviation as built from nominal: mean delay of the light of an exposure after its middle, "
                 "where the encoders are latched"},
                0)),
        field(e.jitter,
              bounded({"jitter", kSecond,
                       "Deviation as built from nominal: standard deviation of the delay of the light from "
                       "exposure to exposure. The light never precedes the instant of firing"},
                      0)));
  }
};

/// Deviations of the cell as built from its description. All zero: the nominal cell.
struct AsBuilt {
  std::array<DhDeviation, kMaxJoints> dh{};
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
inline constexpr EnumerationItem kTriggerModeItems[] = {
    {"off", "no exposures"},
    {"time", "periodic in time"},
    {"table_angle", "periodic in the table angle"},
    {"path_distance", "periodic in the distance travelled by the sensor over the table"},
    {"request", "on request only"},
};
template <>
inline constexpr Enumeration enumeration_of<TriggerMode> = make_enumeration("TriggerMode", kTriggerModeItems);

constexpr double kMaxPathClock = 1e9;  // s: longer than any segment
constexpr double kMaxDuration = 1e9;   // s: the largest simulation time

struct TriggerCommand {
  std::int32_t mode = 0;
  double period = 0;                    // s
  double angle = 0;                     // rad
  double distance = 0;                  // m
  std::int32_t request = 0;             // every increase fires one exposure
  double from = 0, to = kMaxPathClock;  // s of the path clock of a running segment

  template <class Visitor>
  static void declare(Visitor& visit, TriggerCommand& c) {
    visit(
        c,
        choice_field<TriggerMode>(
            c.mode, {"mode", kNone,
                     "Trigger mode of the sensor. Modes 1 to 3 fire when the mode is entered or "
                     "its interval is changed, and at every interval from there; in controller mode 6 "
                     "instead when the path clock of a segment reaches command.trigger.from"}),
        field(c.period, bounded({"period", kSecond,
                                 "Time between two exposures in trigger mode 1; at least 1 microsecond"},
                                0, kMaxDuration)),
        field(c.angle,
              bounded({"angle", kRadian,
                       "Rotation of the table, in either direction, between two exposures in trigger mode "
                       "2; above 0"},
                      0)),
        field(c.distance,
              bounded({"distance", kMetre,
                       "Path length of the sensor origin in the rotating frame of the table between two "
                       "exposures in trigger mode 3; above 0"},
                      0)),
        field(c.request,
              {"request", kNone, "Counter: every increase fires one exposure, in any trigger mode but 0"}),
        field(c.from, bounded({"from", kSecond,
                               "Controller mode 6: path clock of the running segment at which trigger modes "
                               "1 to 3 fire for the first time; no effect in other controller modes"},
                              0, kMaxPathClock)),
        field(c.to, bounded({"to", kSecond,
                             "Controller mode 6: path clock of the running segment up to which trigger "
                             "modes 1 to 3 fire, to 1 microsecond; no effect in other controller modes"},
                            0, kMaxPathClock)));
  }
};

struct ConveyorCommand {
  double speed = 0;  // m/s

  template <class Visitor>
  static void declare(Visitor& visit, ConveyorCommand& c) {
    visit(c, field(c.speed,
                   {"speed", kMetrePerSecond,
                    "Commanded speed of the belt of {}, positive along x of the belt frame; clamped to the "
                    "maximum speed, read at the next controller cycle, approached with constant "
                    "acceleration"}));
  }
};

constexpr double kMaxGuardTime = 2e9;  // s: beyond the largest simulation time
constexpr double kMinSpeed = 1e-6;     // fraction of the full speed: a move ends

constexpr Element kTargetElements[kAxes] = {
    {"q[1]", "joint 1"}, {"q[2]", "joint 2"}, {"q[3]", "joint 3"},
    {"q[4]", "joint 4"}, {"q[5]", "joint 5"}, {"q[6]", "joint 6"},
    {"q[7]", "joint 7"}, {"q[8]", "joint 8"}, {"table", "the rotary table, not wrapped"},
};
constexpr Element kPositionElements[] = {{"[1]", "x"}, {"[2]", "y"}, {"[3]", "z"}};
constexpr Element kQuaternionElements[] = {{"[1]", "w"}, {"[2]", "x"}, {"[3]", "y"}, {"[4]", "z"}};
constexpr Element kJogElements[kAxes] = {
    {"[1]", "joint 1; in mode 5 the sensor along x"},
    {"[2]", "joint 2; in mode 5 the sensor along y"},
    {"[3]", "joint 3; in mode 5 the sensor along z"},
    {"[4]", "joint 4; in mode 5 the sensor about x"},
    {"[5]", "joint 5; in mode 5 the sensor about y"},
    {"[6]", "joint 6; in mode 5 the sensor about z"},
    {"[7]", "joint 7"},
    {"[8]", "joint 8"},
    {"[{t}]", "the rotary table, in mode 5, too"},
};

/// Mode, jog frame and operation are those of control/command.h.
struct MotionCommand {
  std::int32_t mode = 0;
  std::string program;                      // path of a file, relative to the FMU's resources, or absolute
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
                        kTargetElements)),
        field(c.target_position,
              with_elements(
                  {"target.position", kMetre,
                   "Target of the next linear move: {e} of the sensor origin, world frame, by the nominal "
                   "geometry of the arm"},
                  kPositionElements)),
        field(c.target_orientation,
              with_elements(
                  bounded({"target.orientation", kNone,
                           "Target of the next linear move: {e} of the unit quaternion world_from_sensor, by "
                           "the nominal geometry of the arm; scaled to unit length where its norm is from "
                           "0.99 to 1.01"},
                          -1, 1),
                  kQuaternionElements)),
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
                 "pauses. Streamed set-points and jogs are not scaled; with a guard, 0 lets no jog begin"},
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
                   "until command.guard.time is after controller.path_time, jogs for a command.monitor_speed "
                   "above 0, too. Moves and segments slow down from full speed at half this age to rest at "
                   "this age and wait on their paths for an increase of command.reset; older, set-points and "
                   "jogs (modes 1, 4, 5) end in an emergency stop; 0: no guard"},
                  0)));
  }
};

/// Message for the person at the pendant.
struct PendantCommand {
  std::string text;
  bool beep = false;

  template <class Visitor>
  static void declare(Visitor& visit, PendantCommand& c) {
    visit(c,
          field(c.text, {"text", kNone,
                         "Text for the pendant from the next communication step on, shown while the "
                         "controller has no message of its own"}),
          field(c.beep, {"beep", kNone, "True: the pendant beeps"}));
  }
};

struct GripperCommandInputs {
  std::int32_t mode = 0;
  double width = 0;  // m
  double force = 0;  // N

  template <class Visitor>
  static void declare(Visitor& visit, GripperCommandInputs& c) {
    visit(
        c,
        choice_field<GripperMode>(c.mode, {"mode", kNone, "Gripper mode, read at the next controller cycle"}),
        field(c.width,
              bounded({"width", kMetre,
                       "Commanded distance between the pads in gripper mode 1, clamped to the stroke; the "
                       "fingers move at their maximum speed with up to their maximum force"},
                      0)),
        field(c.force,
              bounded({"force", kNewton,
                       "Commanded grip force of each finger in gripper mode 2, clamped to the maximum "
                       "force; the fingers close at their maximum speed"},
                      0)));
  }
};

struct CellInputs {
  explicit CellInputs(const CellLayout& layout) : conveyors(layout.conveyors) {}

  MotionCommand motion;
  std::int32_t segment = 0;
  TriggerCommand trigger;
  double exposure = 0;  // s
  PerDevice<ConveyorCommand> conveyors;
  GripperCommandInputs gripper;  // ignored in a cell without gripper
  PendantCommand pendant;
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
  explicit Bodies(const CellLayout& layout)
      : links(layout.joints.size()), parts(layout.parts.size()), fingers(layout.gripper ? 2 : 0) {}

  PerDevice<BodyState> links;
  BodyState sensor, table;
  PerDevice<BodyState> parts, fingers;
};

constexpr Element kEncoderElements[kAxes] = {
    {"q[1]", "joint 1"}, {"q[2]", "joint 2"}, {"q[3]", "joint 3"},
    {"q[4]", "joint 4"}, {"q[5]", "joint 5"}, {"q[6]", "joint 6"},
    {"q[7]", "joint 7"}, {"q[8]", "joint 8"}, {"table", "the rotary table, not wrapped"},
};
constexpr Element kEncoderRateElements[kAxes] = {
    {"qd[1]", "joint 1"}, {"qd[2]", "joint 2"}, {"qd[3]", "joint 3"},
    {"qd[4]", "joint 4"}, {"qd[5]", "joint 5"}, {"qd[6]", "joint 6"},
    {"qd[7]", "joint 7"}, {"qd[8]", "joint 8"}, {"table_rate", "the rotary table"},
};

/// Encoder readings (joints, then table).
struct Measurement {
  std::array<double, kAxes> position{};
  std::array<double, kAxes> rate{};

  template <class Visitor>
  static void declare(Visitor& visit, Measurement& m) {
    visit(m,
          field(m.position,
                with_axes(initially(Initial::kEncoders, {"", kRadian, "Measured angle of {e} (encoder){}"}),
                          kEncoderElements)),
          field(m.rate, with_axes({"", kRadianPerSecond, "Measured angular velocity of {e}{}"},
                                  kEncoderRateElements)));
  }
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

  template <class Visitor>
  static void declare(Visitor& visit, TriggerRecord& r) {
    visit(
        r,
        field(r.index,
              bounded(
                  {"index", kNone,
                   "Number of the exposure in the current record, counted from 1; 0 before the first record. "
                   "At "
                   "the end of each communication step the oldest queued record, if any, becomes the current "
                   "one"},
                  0)),
        field(r.segment,
              {"segment", kNone, "Value of command.segment when the exposure of the current record fired"}),
        field(r.time,
              instant("time",
                      "Simulation time at the middle of the exposure of the current record; 0 before the "
                      "first record")),
        field(r.exposure,
              bounded({"exposure", kSecond, "Duration of the exposure of the current record"}, 0)),
        state(r.measured, "measured"), state(r.truth, "truth"));
  }
};

struct ConveyorOutputs {
  double speed = 0;           // m/s
  double travel = 0;          // m since the start
  double texture_offset = 0;  // travel modulo the belt length, m

  template <class Visitor>
  static void declare(Visitor& visit, ConveyorOutputs& o) {
    visit(
        o,
        field(o.speed, continuous({"speed", kMetrePerSecond,
                                   "Speed of the belt of {}, positive along x of the belt frame"})),
        field(o.travel,
              continuous({"travel", kMetre, "Signed distance travelled by the belt of {} since the start"})),
        field(o.texture_offset,
              bounded(continuous(
                          {"texture_offset", kMetre,
                           "Distance travelled by the belt of {} modulo the belt length: texture offset for "
                           "visualization"}),
                      0)));
  }
};

constexpr Element kDestinationElements[kAxes] = {
    {"q[1]", "angle of joint 1"}, {"q[2]", "angle of joint 2"}, {"q[3]", "angle of joint 3"},
    {"q[4]", "angle of joint 4"}, {"q[5]", "angle of joint 5"}, {"q[6]", "angle of joint 6"},
    {"q[7]", "angle of joint 7"}, {"q[8]", "angle of joint 8"}, {"table", "angle of the table"},
};

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
        field(o.rate,
              bounded({"rate", kNone,
                       "Rate of the path clock against time, 0 to 1: the speed of the running move or "
                       "segment as a fraction of its full speed; 0 where none runs"},
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
             "Simulation time at which the controller took up the running or last move or segment, or with a "
             "guard the latest jog or increase of its deflection: from then on controller.ahead shows its "
             "path. With a guard it waits for a later command.guard.time"}));
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

constexpr Element kPadElements[] = {
    {"truth.finger[1].normal_force", "1"},
    {"truth.finger[2].normal_force", "2"},
};
constexpr Element kPadForceElements[] = {
    {"truth.finger[1].contact_force[1]", "x component, world frame, of the pad of finger 1"},
    {"truth.finger[1].contact_force[2]", "y component, world frame, of the pad of finger 1"},
    {"truth.finger[1].contact_force[3]", "z component, world frame, of the pad of finger 1"},
    {"truth.finger[2].contact_force[1]", "x component, world frame, of the pad of finger 2"},
    {"truth.finger[2].contact_force[2]", "y component, world frame, of the pad of finger 2"},
    {"truth.finger[2].contact_force[3]", "z component, world frame, of the pad of finger 2"},
};

struct GripperOutputs {
  double width = 0;  // m
  double force = 0;  // N
  bool gripped = false;
  std::array<double, 2> normal_force{};  // N, of each pad on the parts
  std::array<std::array<double, 3>, 2>
      contact_force{};  // N, of each pad on the parts, friction included, world axes

  template <class Visitor>
  static void declare(Visitor& visit, GripperOutputs& o) {
    visit(o,
          field(o.width, initially(Initial::kDescription,
                                   continuous({"measured.gripper.width", kMetre,
                                               "Measured distance between the pads of the two fingers"}))),
          field(o.force, {"measured.gripper.force", kNewton,
                          "Measured closing force, mean of the two finger drives; negative while opening"}),
          field(o.gripped,
                {"measured.gripper.gripped", kNone,
                 "True if the gripper holds an object: the fingers press with the commanded force and stand "
                 "still without being closed"}),
          field(o.normal_force,
                with_elements(
                    {"", kNewton,
                     "Normal force of the pad of finger {e} on all parts that it touches in the current "
                     "dynamics step"},
                    kPadElements)),
          field(o.contact_force,
                with_elements(
                    {"", kNewton,
                     "Contact force on all parts that it touches, friction included, in the current dynamics "
                     "step: {e}"},
                    kPadForceElements)));
  }
};

constexpr Element kCollisionPointElements[] = {
    {"truth.collision.point[1]", "x"}, {"truth.collision.point[2]", "y"}, {"truth.collision.point[3]", "z"}};

/// A colliding pair of bodies.
struct PairCollision {
  std::int32_t pair = 0;          // zero-based, in the order of the description
  double depth = 0;               // m
  std::array<double, 3> point{};  // m, world, the deepest one
  double least_depth = 0;         // m, since the collision began or was last reported as deeper
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
  bool begins = false;                       // internal: a pair collides that did not at the cycle before
  bool deepens = false;                      // internal: a pair has become deeper
  std::vector<PairCollision> colliding;      // internal: at the last cycle
  std::vector<PairCollision> passed;         // internal: since then, of pairs that did not collide there

  /// {} is replaced by the numbers of the bodies.
  template <class Visitor>
  static void declare(Visitor& visit, CollisionReading& r) {
    visit(
        r,
        field(r.pairs,
              bounded(
                  {"truth.collision.pairs", kNone,
                   "Number of monitored pairs of bodies that collide at the last controller cycle, or have "
                   "collided between it and the cycle before: their surfaces intersect, or one body encloses "
                   "the other"},
                  0)),
        field(r.body_a,
              bounded({"truth.collision.body_a", kNone, "First body of the deepest collision{}"}, 0)),
        field(r.body_b,
              bounded({"truth.collision.body_b", kNone, "Second body of the deepest collision{}"}, 0)),
        field(r.depth, bounded({"truth.collision.depth", kMetre,
                                "Penetration depth of the deepest collision at the last controller cycle"},
                               0)),
        field(r.point,
              with_elements({"", kMetre, "Deepest point of the deepest collision: {e} in the world frame"},
                            kCollisionPointElements)),
        field(
            r.clearance,
            initially(
                Initial::kDescription,
                bounded({"truth.clearance.distance", kMetre,
                         "Smallest distance of all monitored pairs of bodies, 0 during a collision, at most "
                         "the collision range of the description at the last controller cycle"},
                        0))),
        field(r.near_a, bounded({"truth.clearance.body_a", kNone, "First body of the closest pair{}"}, 0)),
        field(r.near_b, bounded({"truth.clearance.body_b", kNone, "Second body of the closest pair{}"}, 0)),
        state(r.near_faces, "near_faces"), state(r.begins, "begins"), state(r.deepens, "deepens"),
        state(r.colliding, "colliding"), state(r.passed, "passed"));
  }
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
  control::PathAhead ahead{};  // written on demand
  PendantOutputs pendant;
  std::array<double, kMaxJoints> motor_torque{};  // N m, with dynamic drives
  PerDevice<ConveyorOutputs> conveyors;
  GripperOutputs gripper;
  Readings readings;
  std::int32_t solver_fallbacks = 0;    // contact problems that were not solved as intended
  std::int32_t truncated_contacts = 0;  // pairs of bodies whose contacts were lost in part
};

}  // namespace robotcell
