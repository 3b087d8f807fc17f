// The robot controller: modes, operation, monitor speed, emergency stop. Independent of dynamics and FMI.
#pragma once

#include <cstdint>

#include "fmu/control/arm_geometry.h"
#include "fmu/control/command.h"
#include "fmu/control/guard_watch.h"
#include "fmu/control/jog.h"
#include "fmu/control/jog_permit.h"
#include "fmu/control/programmed_move.h"
#include "fmu/control/servo_controller.h"

namespace robotcell::control {

struct ControllerSettings {
  MotionLimits motion;
  JogLimits jog;
  std::int64_t cycle_us = 0;
};

/// A requested move or segment that waits until the axes are at rest.
struct PendingMove {
  bool pending = false;
  Mode mode = Mode::kJointMove;
  std::shared_ptr<const ProgramSegment> segment;  // in program mode; null: there is none
  Axes position{};
  bool has_pose = false;  // of the tool; false: the command had none, or no tool
  Eigen::Isometry3d flange_from_tool = Eigen::Isometry3d::Identity();
  Eigen::Vector3d tool_position = Eigen::Vector3d::Zero();
  Eigen::Quaterniond tool_orientation = Eigen::Quaterniond::Identity();
  double speed = 1;
};

/// Complete state of the controller.
struct ControllerState {
  ServoState servo;
  MoveState move;
  JogState jog;
  PendingMove pending_move;
  Eigen::Isometry3d flange_from_tool = Eigen::Isometry3d::Identity();  // of the last linear move or jog
  Mode mode = Mode::kHold;                                             // active mode
  Phase phase = Phase::kRest;
  bool stopped = false;                                 // emergency stop active
  ControllerError error = ControllerError::kNone;       // of the current command
  ControllerError path_error = ControllerError::kNone;  // of the last requested move
  std::int32_t path_limit = 0;
  std::int32_t start = 0, reset = 0, heartbeat = 0;  // counters at the last cycle
  std::int64_t heartbeat_us = 0;
  GuardWatch guard;
  JogPermit jog_permit;
  std::int64_t advanced_us = -1;  // last cycle in which a programmed motion advanced
  std::int32_t runs = 0;          // number of segments started
  Axes destination{};
  Axes free{};  // position at the last cycle without a collision
};

/// Path clock of a running segment, for the trigger.
struct RunningSegment {
  std::int32_t run = 0;  // number of the run, counted from 1; 0: none is running
  ClockPoint path_clock;
};

/// Reads a command once per cycle and computes the axes one cycle ahead.
///
/// Changes between servo and hold are immediate. Any other change of mode, and of the tool in a jog, waits
/// until the axes are at rest; a programmed motion stops on its path. A move or segment starts from where the
/// axes have come to rest, and an infeasible one does not start. In manual operation only jogs are accepted,
/// in automatic operation everything else.
///
/// A collision that begins ends in an emergency stop, and so does one that becomes deeper after a reset,
/// unless the axes approach the position of the last cycle without a collision: a motion back is always
/// possible.
///
/// A guard that watches the robot must answer states of the robot in time. A programmed motion and a jog wait
/// at their start until a state that shows their path is answered. A programmed motion slows down with the
/// age of the last answer and rests on its path where that is too old, until a reset; set-points and jogs
/// then end in an emergency stop.
class RobotController {
 public:
  RobotController(const ControllerSettings& settings, const ArmKinematics& arm, const Axes& start);
  RobotController(const RobotController&) = delete;
  RobotController& operator=(const RobotController&) = delete;

  /// Call at every multiple of the cycle, before sampling a later instant.
  void cycle(std::int64_t now_us, const Command& command);

  /// Set-points of position and velocity at an instant of the current cycle.
  Knots sample(std::int64_t time_us) const { return servo_.sample(time_us); }

  Report report(std::int64_t time_us) const;

  /// Positions ahead on the path of the running motion, its end beyond it, or of the jog; the present ones
  /// where there is neither.
  PathAhead path_ahead(std::int64_t time_us) const;

  /// Whether a command that is read now starts a motion.
  bool starts(const Command& command) const { return command.start > state_.start; }

  /// The segment that runs at an instant of the current cycle; none while it waits for the guard.
  RunningSegment running_segment(std::int64_t time_us) const;

  ControllerState state() const;
  void restore(const ControllerState& state);

 private:
  void latch_inputs(std::int64_t now_us, const Command& command);
  void watch_guard(std::int64_t now_us, const Command& command, bool resets);
  double target_rate(const Command& command) const;
  bool motion_runs() const;
  bool waits_for_guard() const;
  ControllerError check_preconditions(std::int64_t now_us, const Command& command) const;
  Mode requested_mode(const Command& command) const;
  bool changes_tool(Mode mode, const Command& command) const;
  void enter(Mode mode, const Command& command);
  void run(std::int64_t now_us, const Command& command);
  void brake(std::int64_t now_us);
  void run_jog(std::int64_t now_us, const Command& command);
  void run_move(std::int64_t now_us, const Command& command);
  void plan();
  void plan_segment();
  void advance(std::int64_t now_us, const RateRamp& change);
  ClockPoint path_clock(std::int64_t time_us) const;
  void hold(std::int64_t now_us);
  bool at_rest() const;
  bool returns_to_free() const;
  const Knots& present() const { return servo_.state().end; }
  Axes present_position() const;

  ControllerSettings settings_;
  ArmGeometry arm_;
  double cycle_;  // s
  ServoController servo_;
  ProgrammedMove move_;
  Jog jog_;
  ControllerState state_;  // except those of servo_, move_ and jog_, and the tool
};

}  // namespace robotcell::control
