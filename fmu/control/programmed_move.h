// Execution of a programmed move: a path, a speed profile, and a path clock scaled by the monitor speed.
#pragma once

#include "fmu/control/motion_path.h"

namespace robotcell::control {

struct MoveState {
  bool active = false;
  MotionPath path;
  SmoothProfile profile;  // path parameter s as a function of the path clock
  double clock = 0;       // s; runs at real time at full monitor speed
  double rate = 0;        // of the path clock against real time, 0 to 1
};

/// Commanded change of the clock rate.
struct RateRamp {
  double target = 0;     // clock rate
  double max_slope = 0;  // 1/s, maximum change of the rate
};

/// Speed is scaled by the rate of the path clock alone, so the path does not change. The rate changes no
/// faster than the acceleration limits of all axes allow.
class ProgrammedMove {
 public:
  ProgrammedMove(const ArmGeometry& arm, const Limits& limits) : arm_(arm), limits_(limits) {}

  /// Starts on a checked path with the given clock rate; stays inactive where start and end coincide.
  void start(const MotionPath& path, const PathReport& report, double rate);

  /// Advances by one cycle (seconds) from `present`; inactive once the end is reached. Throws
  /// std::logic_error where the inverse kinematics fails on a path that was checked.
  Knots advance(double cycle, const RateRamp& change, const Knots& present);

  void cancel() { state_.active = false; }
  bool active() const { return state_.active; }
  bool stopped() const { return state_.rate == 0; }

  /// Fraction of the path that has been executed.
  double progress() const { return state_.profile.at(state_.clock).position; }

  const MoveState& state() const { return state_; }
  void restore(const MoveState& state) { state_ = state; }

 private:
  struct CycleResult;
  CycleResult cycle_result(double cycle, double rate, const Axes& near) const;
  double acceleration_ratio(double cycle, const Knots& present, const Knots& end) const;

  const ArmGeometry& arm_;
  const Limits& limits_;
  MoveState state_;
};

}  // namespace robotcell::control
