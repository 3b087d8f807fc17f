#include "fmu/control/robot_controller.h"

#include <algorithm>
#include <limits>

namespace robotcell::control {
namespace {

constexpr double kMonitorRamp = 4;  // 1/s: from standstill to full speed in a quarter of a second
constexpr double kAsSteepAsCanBe = std::numeric_limits<double>::infinity();

bool jogs(Mode mode) { return mode == Mode::kJointJog || mode == Mode::kCartesianJog; }
bool moves(Mode mode) { return mode == Mode::kJointMove || mode == Mode::kLineMove; }
/// Modes that may follow one another while the axes move.
bool streams(Mode mode) { return mode == Mode::kHold || mode == Mode::kServo; }

Refusal refusal_of(PathFault fault) {
  switch (fault) {
    case PathFault::kTargetOutOfLimits:
      return Refusal::kTargetOutOfLimits;
    case PathFault::kPathOutOfLimits:
      return Refusal::kPathOutOfLimits;
    case PathFault::kSingular:
      return Refusal::kSingular;
    default:
      return Refusal::kNone;
  }
}

}  // namespace

RobotController::RobotController(const ControllerSettings& settings, const ArmGeometry& arm,
                                 const Axes& start)
    : settings_(settings),
      arm_(arm),
      cycle_(static_cast<double>(settings.cycle_us) * kSecondsPerTick),
      servo_(settings.motion.axes, settings.cycle_us, start),
      move_(arm, settings_.motion.axes),
      jog_(arm, settings_.motion.axes, settings.jog) {
  state_.destination = start;
}

void RobotController::cycle(std::int64_t now_us, const Command& command) {
  listen(now_us, command);
  state_.refusal = objection(now_us, command);
  const Mode next = mode_to_be(command);
  const bool at_once = streams(state_.mode) && streams(next);
  if (next != state_.mode && (at_once || at_rest())) enter(next);
  if (next == state_.mode && !state_.stopped) {
    state_.phase = Phase::kMoving;
    run(now_us, command);
  } else {
    state_.phase = Phase::kBraking;
    brake(now_us);
  }
}

/// Takes the counters, and the moves and stops that they stand for.
void RobotController::listen(std::int64_t now_us, const Command& command) {
  if (command.heartbeat != state_.heartbeat) state_.heartbeat_us = now_us;
  const bool starts = command.start > state_.start;
  const bool resets = command.reset > state_.reset;
  state_.heartbeat = command.heartbeat;
  state_.start = command.start;
  state_.reset = command.reset;
  if (command.emergency_stop) {
    state_.stopped = true;
  } else if (resets && at_rest() && command.mode == Mode::kHold) {
    state_.stopped = false;
  }
  if (!starts || !moves(command.mode)) return;
  state_.path_fault = Refusal::kNone;
  state_.path_limit = 0;
  if (objection(now_us, command) != Refusal::kNone) return;
  state_.awaited = {true,
                    command.mode == Mode::kLineMove,
                    command.position,
                    command.pose.translation(),
                    Eigen::Quaterniond(command.pose.linear()),
                    command.speed};
}

Refusal RobotController::objection(std::int64_t now_us, const Command& command) const {
  if (state_.stopped) return Refusal::kEmergencyStop;
  if (command.mode == Mode::kHold) return Refusal::kNone;
  const bool manual = command.operation == Operation::kManual;
  if (manual && !jogs(command.mode)) return Refusal::kManualOperation;
  if (!manual && jogs(command.mode)) return Refusal::kAutomaticOperation;
  const auto age = static_cast<double>(now_us - state_.heartbeat_us) * kSecondsPerTick;
  const bool streamed = command.mode == Mode::kServo || jogs(command.mode);
  if (streamed && command.max_age > 0 && age > command.max_age) return Refusal::kTooOld;
  return Refusal::kNone;
}

Mode RobotController::mode_to_be(const Command& command) const {
  return state_.refusal == Refusal::kNone ? command.mode : Mode::kHold;
}

void RobotController::enter(Mode mode) {
  state_.mode = mode;
  move_.drop();
  if (jogs(mode)) jog_.enter(present());
  if (moves(mode)) return;
  state_.awaited.waits = false;
  state_.path_fault = Refusal::kNone;
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
      run_move(now_us, command);
      return;
    case Mode::kJointJog:
    case Mode::kCartesianJog: {
      const Knots end = state_.mode == Mode::kJointJog ? jog_.joints(cycle_, command, present())
                                                       : jog_.cartesian(cycle_, command, present());
      servo_.advance(now_us, end, jog_.state().limit);
      state_.destination = present_position();
      return;
    }
  }
}

void RobotController::run_move(std::int64_t now_us, const Command& command) {
  const bool line = state_.mode == Mode::kLineMove;
  if (state_.awaited.waits && state_.awaited.line == line) {
    if (!at_rest()) return brake(now_us);
    plan(command);
  }
  if (!move_.active()) return hold(now_us);
  const Knots end = move_.advance(cycle_, {command.monitor_speed, kMonitorRamp}, present());
  servo_.advance(now_us, end, 0);
}

/// Starts the awaited move from rest, if it can be gone.
void RobotController::plan(const Command& command) {
  const AwaitedMove& awaited = state_.awaited;
  state_.awaited.waits = false;
  const Axes from = present_position();
  const Eigen::Isometry3d target = Eigen::Translation3d(awaited.tool_position) * awaited.tool_turn;
  const MotionPath path = awaited.line ? line_path(arm_, from, target, awaited.position[kArmAxes])
                                       : joint_path(from, awaited.position);
  const PathReport report = inspect(path, arm_, settings_.motion, awaited.speed);
  state_.path_fault = refusal_of(report.fault);
  state_.path_limit = report.axis;
  move_.drop();
  if (report.fault != PathFault::kNone) return;
  state_.destination = report.end;
  move_.start(path, report, command.monitor_speed);
}

/// Brings whatever moves to rest: a programmed move on its path, jogs in their direction, and streamed
/// set-points axis by axis or, in an emergency, all axes together.
void RobotController::brake(std::int64_t now_us) {
  if (move_.active()) {
    const Knots end = move_.advance(cycle_, {0, kAsSteepAsCanBe}, present());
    if (move_.standing()) move_.drop();
    servo_.advance(now_us, end, 0);
  } else if (state_.stopped || !streams(state_.mode)) {
    servo_.advance(now_us, brake_together(cycle_, settings_.motion.axes, present()), 0);
  } else {
    hold(now_us);
  }
}

void RobotController::hold(std::int64_t now_us) { servo_.cycle(now_us, {false, {}}); }

bool RobotController::at_rest() const {
  return std::all_of(present().begin(), present().end(), [](const Knot& knot) { return knot.velocity == 0; });
}

Axes RobotController::present_position() const {
  Axes axes;
  for (std::size_t i = 0; i < kAxes; ++i) axes[i] = present()[i].position;
  return axes;
}

Report RobotController::report(std::int64_t time_us) const {
  Report report;
  report.mode = state_.mode;
  report.moving = servo_.moving(time_us);
  report.phase = report.moving ? state_.phase : Phase::kRest;
  if (state_.stopped) report.phase = Phase::kEmergencyStop;
  report.refusal = state_.refusal;
  if (report.refusal == Refusal::kNone) report.refusal = state_.path_fault;
  if (report.refusal == Refusal::kNone && jogs(state_.mode)) report.refusal = jog_.state().refusal;
  report.limit = state_.path_limit != 0 ? state_.path_limit : servo_.state().limit;
  report.progress = move_.progress();
  report.destination = state_.destination;
  report.at_destination = !report.moving && present_position() == state_.destination;
  return report;
}

ControllerState RobotController::state() const {
  ControllerState state = state_;
  state.servo = servo_.state();
  state.move = move_.state();
  state.jog = jog_.state();
  return state;
}

void RobotController::restore(const ControllerState& state) {
  state_ = state;
  servo_.restore(state.servo);
  move_.restore(state.move);
  jog_.restore(state.jog);
}

}  // namespace robotcell::control
