// Execution of a programmed motion: a path, the path clock, and its rate, scaled by the monitor speed.
#pragma once

#include <memory>

#include "fmu/control/command.h"

namespace robotcell::control {

struct MoveState {
  bool active = false;
  std::shared_ptr<const ProgramSegment> segment;  // of a program; null: a move along `path`
  MotionPath path;
  SmoothProfile profile;  // path parameter s of a move as a function of the path clock
  ClockPoint start, end;  // of the present cycle
};

/// Commanded change of the clock rate.
struct RateRamp {
  double target = 0;     // clock rate
  double max_slope = 0;  // 1/s, maximum change of the rate
};

/// Axes at the end of a cycle. `duration` (s) is shorter than the cycle where the axes arrive within it.
struct CycleEnd {
  Knots knots;
  double duration = 0;
};

/// Speed is scaled by the rate of the path clock alone, so the path does not change. The rate changes no
/// faster than the acceleration limits of all axes allow.
class ProgrammedMove {
 public:
  ProgrammedMove(const ArmGeometry& arm, const Limits& limits) : arm_(arm), limits_(limits) {}

  /// Takes up a checked path, at rest at its start; stays inactive where start and end coincide.
  void start(const MotionPath& path, const PathReport& report);
  void start(std::shared_ptr<const ProgramSegment> segment);

  /// Sets the clock rate at the start of the path, where the axes rest at any rate; no effect beyond it.
  void begin(double rate);

  /// Advances by one cycle (seconds) from `present`; inactive once the end is reached. Throws
  /// std::logic_error where the inverse kinematics fails on a path that was checked.
  CycleEnd advance(double cycle, const RateRamp& change, const Knots& present);

  void cancel() { state_.active = false; }
  bool active() const { return state_.active; }
  double rate() const { return state_.end.rate; }
  bool stopped() const { return rate() == 0; }

  /// Fraction of the path that has been executed.
  double progress() const;

  /// Path clock at the fraction s of the present cycle of `cycle` seconds.
  ClockPoint clock_at(double s, double cycle) const;

  /// Positions on the path at a value of the path clock, constant beyond the end. `near` is the solution at a
  /// neighbouring point. Throws as `advance`.
  Axes position_at(double clock, const Axes& near) const;

  const MoveState& state() const { return state_; }
  void restore(const MoveState& state) { state_ = state; }

 private:
  struct CycleResult;
  double duration() const { return state_.segment ? state_.segment->duration() : state_.profile.duration(); }
  Axes destination() const { return state_.segment ? state_.segment->end() : state_.path.to; }
  Knots on_path(double clock, const Axes& near) const;
  CycleResult cycle_result(double cycle, double rate, const Axes& near) const;
  double acceleration_ratio(double cycle, const Knots& present, const Knots& end) const;

  const ArmGeometry& arm_;
  const Limits& limits_;
  MoveState state_;
};

}  // namespace robotcell::control
