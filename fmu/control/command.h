// Commands to the robot controller, and its status report.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <memory>
#include <optional>

#include "fmu/control/axis.h"
#include "fmu/control/enumeration.h"
#include "fmu/control/program.h"

namespace robotcell::control {

enum class Mode : std::int32_t { kHold, kServo, kJointMove, kLineMove, kJointJog, kCartesianJog, kProgram };
inline constexpr EnumerationItem kModeItems[] = {
    {"hold", "brake and rest"},           {"servo", "follow streamed set-points"},
    {"joint_move", "move of all axes"},   {"line_move", "linear move of the sensor"},
    {"joint_jog", "jog of single axes"},  {"cartesian_jog", "Cartesian jog of the sensor"},
    {"program", "segments of a program"},
};

/// Whether the operator moves the axes by jogging.
constexpr bool is_jog(Mode mode) { return mode == Mode::kJointJog || mode == Mode::kCartesianJog; }

enum class Operation : std::int32_t { kManual, kAutomatic };
inline constexpr EnumerationItem kOperationItems[] = {
    {"manual", "only jogs (modes 4 and 5) move the robot"},
    {"automatic", "modes 1 to 3 and 6 move the robot, and jogs are rejected"},
};

enum class JogFrame : std::int32_t { kWorld, kTool };
inline constexpr EnumerationItem kJogFrameItems[] = {
    {"world", "axes of the world"},
    {"sensor", "axes of the tool, at the start the sensor"},
};

/// Collision of bodies of the cell at the last controller cycle.
enum class Collision {
  kNone,
  kPresent,
  kDeepens,  // a pair of bodies has become deeper
  kBegins,   // a pair of bodies collides that did not before
};

struct Command {
  Mode mode = Mode::kHold;
  Axes position{};  // rad, set-points in servo mode, targets of moves
  /// Tool of linear moves and jogs; none: invalid.
  std::optional<Eigen::Isometry3d> flange_from_tool = Eigen::Isometry3d::Identity();
  std::optional<Eigen::Isometry3d> pose;          // world_from_tool, target of a linear move
  std::shared_ptr<const ProgramSegment> segment;  // to run in program mode; null: there is none
  double speed = 1;                               // fraction of the full speed, above 0
  double monitor_speed = 1;                       // speed override of moves, and of jogs by a guard, 0 to 1
  Axes jog{};                                     // deflection of each axis, -1 to 1
  JogFrame jog_frame = JogFrame::kWorld;
  Operation operation = Operation::kAutomatic;
  std::int32_t start = 0;  // an increase starts a move or a segment
  bool emergency_stop = false;
  Collision collision = Collision::kNone;  // begins: emergency stop; deepens: unless the axes return
  std::int32_t reset = 0;                  // an increase ends an emergency stop
  std::int32_t heartbeat = 0;              // any change restarts the watchdog
  double max_age = 0;                      // s, timeout of the watchdog; 0 disables it
  std::int64_t guard_us = 0;               // instant of the state that the last message of the guard answers
  double guard_max_age = 0;                // s, largest age of that state; 0: there is no guard
};

enum class Phase : std::int32_t { kRest, kMoving, kBraking, kEmergencyStop };
inline constexpr EnumerationItem kPhaseItems[] = {
    {"rest", "at rest"},
    {"moving", "moving as commanded"},
    {"braking", "braking"},
    {"emergency_stop", "emergency stop"},
};

/// Reason for which a command is not executed.
enum class ControllerError : std::int32_t {
  kNone,
  kManualOperation,     // a programmed mode in manual operation
  kAutomaticOperation,  // a jog mode in automatic operation
  kEmergencyStop,       // emergency stop not yet reset
  kHeartbeatTimeout,    // heartbeat older than max_age
  kTargetOutOfLimits,
  kPathOutOfLimits,
  kSingular,
  kNoSegment,  // the program cannot be read or has no such segment
  kElsewhere,  // the axes are not where the segment starts
  kTooFast,    // the segment exceeds a limit of speed or acceleration
  kGuardTimeout,
  kInvalidOrientation,
  kTriggerInterval,  // a periodic trigger mode without interval
  kTriggerQueue,     // exposures do not fire: too many records are queued
  kGuardedServo,     // servo mode with a guard, which cannot know where set-points lead
};

inline constexpr EnumerationItem kControllerErrorItems[] = {
    {"none", "no error"},
    {"manual_operation", "mode not allowed in manual operation"},
    {"automatic_operation", "mode not allowed in automatic operation"},
    {"emergency_stop", "emergency stop"},
    {"watchdog_timeout", "watchdog timeout"},
    {"target_out_of_limits", "target outside the position limits"},
    {"path_out_of_limits", "path outside the position limits"},
    {"singular", "singularity on the path or target out of reach"},
    {"no_segment", "program cannot be read or has no such segment"},
    {"elsewhere", "axes are not at the start of the segment"},
    {"too_fast", "segment exceeds a limit of speed or acceleration"},
    {"guard_timeout", "guard message too old, reset needed"},
    {"invalid_orientation",
     "command.tool.orientation or command.target.orientation is no unit quaternion: its norm must be from "
     "0.99 to 1.01"},
    {"trigger_interval",
     "trigger mode without interval: command.trigger.period must be at least 1 microsecond, .angle or "
     ".distance above 0, .travel not 0 and .conveyor the number of a conveyor"},
    {"trigger_queue",
     "65536 trigger records are queued, and no more exposures fire: every communication step outputs one "
     "record, use smaller steps"},
    {"guarded_servo",
     "servo mode with a guard: the path of streamed set-points is not known before they move"},
};

/// Path clock against time: clock in s, rate of the clock against real time, 0 to 1.
struct ClockPoint {
  double clock = 0;
  double rate = 0;
};

struct Report {
  Mode mode = Mode::kHold;
  Phase phase = Phase::kRest;
  ControllerError error = ControllerError::kNone;
  std::int32_t limit = 0;  // axis at its limit, counted from 1; 0: none
  bool moving = false;
  bool at_destination = false;
  double progress = 0;
  ClockPoint path_clock;       // of the running or last programmed motion; its rate is 0 where none runs
  double rate = 0;             // present speed as a share of that of the path ahead
  double guard_age = 0;        // s
  double guard_share = 1;      // share of the monitor speed that the guard allows
  bool guard_stopped = false;  // the guard has stopped the robot
  bool guard_waits = false;    // a programmed motion waits at its start for an answer of the guard
  std::int64_t path_us = 0;    // instant at which the running or last programmed motion was taken up
  Axes destination{};
};

}  // namespace robotcell::control

namespace robotcell {

template <>
inline constexpr Enumeration enumeration_of<control::Mode> = make_enumeration("ControllerMode",
                                                                              control::kModeItems);
template <>
inline constexpr Enumeration enumeration_of<control::Operation> = make_enumeration("Operation",
                                                                                   control::kOperationItems);
template <>
inline constexpr Enumeration enumeration_of<control::JogFrame> = make_enumeration("JogFrame",
                                                                                  control::kJogFrameItems);
template <>
inline constexpr Enumeration enumeration_of<control::Phase> = make_enumeration("ControllerState",
                                                                               control::kPhaseItems);
template <>
inline constexpr Enumeration enumeration_of<control::ControllerError> =
    make_enumeration("ControllerError", control::kControllerErrorItems);

}  // namespace robotcell
