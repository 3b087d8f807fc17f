// What the controller reports: status, path clock, path ahead, complete state.
#include <algorithm>

#include "fmu/control/robot_controller.h"
#include "fmu/control/time_units.h"

namespace robotcell::control {

Report RobotController::report(std::int64_t time_us) const {
  Report report;
  report.mode = state_.mode;
  report.moving = servo_.moving(time_us);
  report.phase = report.moving ? state_.phase : Phase::kRest;
  if (state_.stopped) report.phase = Phase::kEmergencyStop;
  report.error = state_.error;
  if (report.error == ControllerError::kNone) report.error = state_.path_error;
  if (report.error == ControllerError::kNone && is_jog(state_.mode)) report.error = jog_.state().error;
  report.limit = state_.path_limit != 0 ? state_.path_limit : servo_.state().limit;
  report.progress = move_.progress();
  report.path_clock = path_clock(time_us);
  const JogPermit& permit = state_.jog_permit;
  report.rate = is_jog(state_.mode) ? std::max(jog_.share_of_ahead(permit.shown(), sample(time_us)),
                                               permit.held(state_.guard))
                                    : report.path_clock.rate;
  report.guard_age = state_.guard.age(time_us);
  report.guard_share = state_.guard.share;
  report.guard_stopped = state_.guard.stopped;
  report.guard_waits = waits_for_guard();
  report.path_us = state_.guard.path_us;
  report.destination = state_.destination;
  report.at_destination = !report.moving && present_position() == state_.destination;
  return report;
}

/// Path clock of the running or last programmed motion; its rate is 0 where none runs.
ClockPoint RobotController::path_clock(std::int64_t time_us) const {
  if (state_.advanced_us != servo_.state().start_us) return {move_.state().end.clock, 0};
  const double duration_us = servo_.state().duration_us;
  const double s = static_cast<double>(time_us - state_.advanced_us) / duration_us;
  return move_.clock_at(std::min(1.0, s), duration_us * kSecondsPerMicrosecond);
}

/// Whether a programmed motion moves the axes in the current cycle or pauses on its path.
bool RobotController::motion_runs() const {
  return move_.active() || state_.advanced_us == servo_.state().start_us;
}

/// Whether a motion waits at its start for an answer to a state that shows its path.
bool RobotController::waits_for_guard() const {
  return move_.active() ? state_.guard.waits() : state_.jog_permit.waits(state_.guard);
}

RunningSegment RobotController::running_segment(std::int64_t time_us) const {
  if (!motion_runs() || waits_for_guard() || !move_.state().segment) return {};
  return {state_.runs, path_clock(time_us)};
}

PathAhead RobotController::path_ahead(std::int64_t time_us) const {
  Axes position;
  const Knots now = sample(time_us);
  for (std::size_t i = 0; i < kAxes; ++i) position[i] = now[i].position;
  PathAhead ahead;
  ahead.fill(position);
  if (is_jog(state_.mode)) return jog_.path_ahead(state_.jog_permit.shown(), now, cycle_);
  if (!motion_runs()) return ahead;
  double clock = path_clock(time_us).clock;
  for (std::size_t k = 1; k < kAheadPoints; ++k) {
    clock += cycle_;
    position = ahead[k] = move_.position_at(clock, position);
  }
  return ahead;
}

ControllerState RobotController::state() const {
  ControllerState state = state_;
  state.servo = servo_.state();
  state.move = move_.state();
  state.jog = jog_.state();
  state.flange_from_tool = arm_.flange_from_tool();
  return state;
}

void RobotController::restore(const ControllerState& state) {
  state_ = state;
  servo_.restore(state.servo);
  move_.restore(state.move);
  jog_.restore(state.jog);
  arm_.set_tool(state.flange_from_tool);
}

}  // namespace robotcell::control
