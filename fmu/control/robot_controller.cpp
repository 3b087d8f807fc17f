#include "fmu/control/robot_controller.h"

#include <algorithm>
#include <limits>

#include "fmu/control/time_units.h"

namespace robotcell::control {
namespace {

constexpr double kMaxMonitorSlope = 4;  // 1/s: from standstill to full speed in 0.25 s
constexpr double kUnlimitedSlope = std::numeric_limits<double>::infinity();

/// Programmed motions: on a path that is known as a whole.
bool moves(Mode mode) {
  return mode == Mode::kJointMove || mode == Mode::kLineMove || mode == Mode::kProgram;
}
/// Modes that may follow each other while the axes move.
bool streams(Mode mode) { return mode == Mode::kHold || mode == Mode::kServo; }

bool streams_commands(Mode mode) { return mode == Mode::kServo || is_jog(mode); }

ControllerError error_of(PathFault fault) {
  switch (fault) {
    case PathFault::kTargetOutOfLimits:
      return ControllerError::kTargetOutOfLimits;
    case PathFault::kPathOutOfLimits:
      return ControllerError::kPathOutOfLimits;
    case PathFault::kSingular:
      return ControllerError::kSingular;
    case PathFault::kElsewhere:
      return ControllerError::kElsewhere;
    case PathFault::kTooFast:
      return ControllerError::kTooFast;
    default:
      return ControllerError::kNone;
  }
}

}  // namespace

RobotController::RobotController(const ControllerSettings& settings, const ArmKinematics& arm,
                                 const Axes& start)
    : settings_(settings),
      arm_(arm),
      cycle_(static_cast<double>(settings.cycle_us) * kSecondsPerMicrosecond),
      servo_(settings.motion.axes, settings.cycle_us, start),
      move_(arm_, settings_.motion.axes),
      jog_(arm_, settings_.motion.axes, settings.jog) {
  state_.destination = state_.free = start;
}

void RobotController::cycle(std::int64_t now_us, const Command& command) {
  latch_inputs(now_us, command);
  state_.error = check_preconditions(now_us, command);
  const Mode next = requested_mode(command);
  // The motion stays on its path, in its mode.
  if (state_.error == ControllerError::kNone && state_.guard.stopped && moves(command.mode)) {
    state_.error = ControllerError::kGuardTimeout;
  }
  if (next != state_.pending_move.mode) state_.pending_move = {};  // its start is not carried over
  // An interrupted motion comes to rest and ends, also where its mode is commanded again before.
  const bool interrupted = state_.phase == Phase::kBraking && move_.active();
  const bool at_once = streams(state_.mode) && streams(next);
  const bool changes = next != state_.mode || changes_tool(next, command);
  const bool enters = changes && (at_once || at_rest());
  if (enters) enter(next, command);
  if ((enters || !changes) && !state_.stopped && !interrupted) {
    state_.phase = Phase::kMoving;
    run(now_us, command);
  } else {
    state_.phase = Phase::kBraking;
    jog_.interrupt();
    state_.jog_permit.withdraw();
    brake(now_us);
  }
}

/// Reads the counters, and starts, stops and resets on their changes.
void RobotController::latch_inputs(std::int64_t now_us, const Command& command) {
  if (command.heartbeat != state_.heartbeat) state_.heartbeat_us = now_us;
  const bool starts = this->starts(command);
  const bool resets = command.reset > state_.reset;
  state_.heartbeat = command.heartbeat;
  state_.start = command.start;
  state_.reset = command.reset;
  watch_guard(now_us, command, resets);
  if (command.collision == Collision::kNone) state_.free = present_position();
  const bool deepens = command.collision == Collision::kDeepens && !returns_to_free();
  if (command.emergency_stop || deepens || command.collision == Collision::kBegins) {
    state_.stopped = true;
  } else if (resets && at_rest() && command.mode == Mode::kHold) {
    state_.stopped = false;
  }
  if (!starts || !moves(command.mode)) return;
  state_.path_error = ControllerError::kNone;
  state_.path_limit = 0;
  if (state_.guard.stopped || check_preconditions(now_us, command) != ControllerError::kNone) return;
  PendingMove& move = state_.pending_move;
  move = {};
  move.pending = true;
  move.mode = command.mode;
  move.segment = command.segment;
  move.position = command.position;
  move.speed = command.speed;
  if (!command.pose || !command.flange_from_tool) return;
  move.has_pose = true;
  move.flange_from_tool = *command.flange_from_tool;
  move.tool_position = command.pose->translation();
  move.tool_orientation = Eigen::Quaterniond(command.pose->linear());
}

/// Stops the robot where the last message of the guard is too old: a programmed motion on its path, anything
/// else by an emergency stop.
void RobotController::watch_guard(std::int64_t now_us, const Command& command, bool resets) {
  if (!state_.guard.read(now_us, cycle_, command, resets)) return;
  const bool streamed = streams_commands(command.mode) || (streams_commands(state_.mode) && !at_rest());
  state_.stopped = state_.stopped || streamed;
  state_.guard.stopped = state_.guard.stopped || streamed || moves(command.mode);
}

/// Rate of the path clock that a programmed motion approaches.
double RobotController::target_rate(const Command& command) const {
  return command.monitor_speed * state_.guard.permitted_share();
}

ControllerError RobotController::check_preconditions(std::int64_t now_us, const Command& command) const {
  if (state_.stopped) return ControllerError::kEmergencyStop;
  if (command.mode == Mode::kHold) return ControllerError::kNone;
  const bool manual = command.operation == Operation::kManual;
  if (manual && !is_jog(command.mode)) return ControllerError::kManualOperation;
  if (!manual && is_jog(command.mode)) return ControllerError::kAutomaticOperation;
  if (command.mode == Mode::kServo && command.guard_max_age > 0) return ControllerError::kGuardedServo;
  if (is_jog(command.mode) && !command.flange_from_tool) return ControllerError::kInvalidOrientation;
  const auto age = static_cast<double>(now_us - state_.heartbeat_us) * kSecondsPerMicrosecond;
  const bool watched = command.max_age > 0 && streams_commands(command.mode);
  if (watched && age > command.max_age) return ControllerError::kHeartbeatTimeout;
  return ControllerError::kNone;
}

Mode RobotController::requested_mode(const Command& command) const {
  return state_.error == ControllerError::kNone ? command.mode : Mode::kHold;
}

/// Whether a mode begins with another tool than that of the last linear move or jog.
bool RobotController::changes_tool(Mode mode, const Command& command) const {
  return is_jog(mode) && command.flange_from_tool->matrix() != arm_.flange_from_tool().matrix();
}

void RobotController::enter(Mode mode, const Command& command) {
  state_.mode = mode;
  move_.cancel();
  state_.jog_permit = {};
  if (is_jog(mode)) {
    arm_.set_tool(*command.flange_from_tool);
    jog_.enter(present());
  }
  if (moves(mode)) return;
  state_.path_error = ControllerError::kNone;
  state_.path_limit = 0;
}

void RobotController::run(std::int64_t now_us, const Command& command) {
  switch (state_.mode) {
    case Mode::kHold:
      hold(now_us);
      if (!at_rest()) state_.phase = Phase::kBraking;
      return;
    case Mode::kServo:
      servo_.cycle(now_us, {true, command.position});
      for (std::size_t i = 0; i < kAxes; ++i) {
        const AxisLimits& axis = settings_.motion.axes[i];
        state_.destination[i] = std::clamp(command.position[i], axis.min, axis.max);
      }
      return;
    case Mode::kJointMove:
    case Mode::kLineMove:
    case Mode::kProgram:
      run_move(now_us, command);
      return;
    case Mode::kJointJog:
    case Mode::kCartesianJog:
      run_jog(now_us, command);
      return;
  }
}

void RobotController::run_jog(std::int64_t now_us, const Command& command) {
  const Command permitted = state_.jog_permit.read(command, at_rest(), now_us, state_.guard);
  const Knots end = state_.mode == Mode::kJointJog
                        ? jog_.joints(cycle_, permitted, present())
                        : jog_.cartesian(cycle_, permitted, jog_released(command), present());
  servo_.advance(now_us, end, jog_.state().limit);
  state_.destination = present_position();
}

void RobotController::run_move(std::int64_t now_us, const Command& command) {
  if (state_.pending_move.pending) {
    if (!at_rest()) return brake(now_us);
    state_.mode == Mode::kProgram ? plan_segment() : plan();
    state_.pending_move = {};
    if (move_.active()) state_.guard.path_us = now_us;
  }
  if (!move_.active()) return hold(now_us);
  const double rate = target_rate(command);
  move_.begin(rate);
  const bool guard_slows = rate < std::min(command.monitor_speed, move_.rate());
  advance(now_us, {rate, guard_slows ? kUnlimitedSlope : kMaxMonitorSlope});
}

void RobotController::advance(std::int64_t now_us, const RateRamp& change) {
  const CycleEnd end = move_.advance(cycle_, change, present());
  servo_.advance(now_us, end.knots, 0, end.duration);
  state_.advanced_us = now_us;
}

/// Takes up the pending move from rest, if its path is feasible.
void RobotController::plan() {
  const PendingMove& pending_move = state_.pending_move;
  const bool line = pending_move.mode == Mode::kLineMove;
  move_.cancel();
  if (line && !pending_move.has_pose) {
    state_.path_error = ControllerError::kInvalidOrientation;
    return;
  }
  if (line) arm_.set_tool(pending_move.flange_from_tool);
  const Axes from = present_position();
  const Eigen::Isometry3d target =
      Eigen::Translation3d(pending_move.tool_position) * pending_move.tool_orientation;
  const MotionPath path =
      line ? line_path(arm_, from, target, pending_move.position) : joint_path(from, pending_move.position);
  const PathReport report = check_path(path, arm_, settings_.motion, pending_move.speed);
  state_.path_error = error_of(report.fault);
  state_.path_limit = report.axis;
  if (report.fault != PathFault::kNone) return;
  state_.destination = report.end;
  move_.start(path, report);
}

/// Takes up the pending segment from rest, if the axes are where it starts and it keeps the limits.
void RobotController::plan_segment() {
  const std::shared_ptr<const ProgramSegment> segment = state_.pending_move.segment;
  move_.cancel();
  state_.path_error = ControllerError::kNoSegment;
  if (!segment) return;
  const PathReport report = check_segment(*segment, present_position(), settings_.motion.axes);
  state_.path_error = error_of(report.fault);
  state_.path_limit = report.axis;
  if (report.fault != PathFault::kNone) return;
  state_.destination = report.end;
  ++state_.runs;
  move_.start(segment);
}

/// Brakes: a programmed motion on its path, a jog in its direction, and servo motion axis by axis or, in an
/// emergency stop, with all axes in proportion.
void RobotController::brake(std::int64_t now_us) {
  if (move_.active()) {
    advance(now_us, {0, kUnlimitedSlope});
    if (move_.stopped()) move_.cancel();
  } else if (state_.stopped || !streams(state_.mode)) {
    servo_.advance(now_us, brake_synchronously(cycle_, settings_.motion.axes, present()), 0);
  } else {
    hold(now_us);
  }
}

void RobotController::hold(std::int64_t now_us) { servo_.cycle(now_us, {false, {}}); }

bool RobotController::at_rest() const {
  return std::all_of(present().begin(), present().end(), [](const Knot& knot) { return knot.velocity == 0; });
}

/// Whether the axes approach the position at the last cycle without a collision.
bool RobotController::returns_to_free() const {
  double rate = 0;  // of half the squared distance
  for (std::size_t i = 0; i < kAxes; ++i) {
    rate += (present()[i].position - state_.free[i]) * present()[i].velocity;
  }
  return rate < 0;
}

Axes RobotController::present_position() const {
  Axes axes;
  for (std::size_t i = 0; i < kAxes; ++i) axes[i] = present()[i].position;
  return axes;
}

}  // namespace robotcell::control
