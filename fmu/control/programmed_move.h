// A programmed motion under way: a path, a profile along it, and a clock that the monitor speed slows down.
#pragma once

#include "fmu/control/motion_path.h"

namespace robotcell::control {

struct MoveState {
  bool active = false;
  MotionPath path;
  SmoothProfile profile;  // of the path's s, by the clock
  double clock = 0;       // s; runs as fast as time at full monitor speed
  double rate = 0;        // of the clock, 0..1
};

/// How the rate of the clock may change in one cycle.
struct RateChange {
  double wanted = 0;    // rate
  double steepest = 0;  // 1/s
};

/// Speed is scaled by the clock's rate alone, so the path stays what it is; the rate changes no faster than
/// the acceleration limits of all axes allow.
class ProgrammedMove {
 public:
  ProgrammedMove(const ArmGeometry& arm, const Limits& limits) : arm_(arm), limits_(limits) {}

  /// Starts along a path that was inspected, with the clock at a rate; not active afterwards if there is
  /// nothing to go.
  void start(const MotionPath& path, const PathReport& report, double rate);

  /// Goes on for one cycle (seconds) from `present`; afterwards it is active no more if the end is reached.
  /// Throws std::logic_error when a line cannot be followed although it was inspected.
  Knots advance(double cycle, const RateChange& change, const Knots& present);

  void drop() { state_.active = false; }
  bool active() const { return state_.active; }
  bool standing() const { return state_.rate == 0; }

  /// Share of the path that is done.
  double progress() const { return state_.profile.at(state_.clock).position; }

  const MoveState& state() const { return state_; }
  void restore(const MoveState& state) { state_ = state; }

 private:
  struct Outcome;
  Outcome outcome(double cycle, double rate, const Axes& near) const;
  double effort(double cycle, const Knots& present, const Knots& end) const;

  const ArmGeometry& arm_;
  const Limits& limits_;
  MoveState state_;
};

}  // namespace robotcell::control
