// Jogs that a guard must have answered before they move the robot.
#pragma once

#include <cstdint>

#include "fmu/control/command.h"
#include "fmu/control/guard_watch.h"

namespace robotcell::control {

/// Holds a jog back until the guard has answered a state that contains it.
///
/// A jog in another direction begins at rest. One that grows in its direction goes on at the deflection that
/// is permitted; one that shrinks does so at once. A monitor speed of 0 permits none. Without a guard every
/// jog is permitted.
struct JogPermit {
  Mode mode = Mode::kJointJog;
  JogFrame frame = JogFrame::kWorld;
  Axes direction{};       // deflections, the largest of them 1 or -1
  double deflection = 0;  // permitted
  double proposed = 0;    // sent to the guard; above `deflection` until it is answered

  /// Reads a command at the start of a cycle; returns the deflections that may be in force in it.
  Axes read(const Command& command, bool at_rest, std::int64_t now_us, GuardWatch& guard);

  /// The jog ends; its direction is kept until the axes rest.
  void withdraw() { deflection = proposed = 0; }

  /// Whether a deflection is waiting for an answer.
  bool waits() const { return proposed > deflection; }

  /// The jog that is sent to the guard.
  Command shown() const;
};

}  // namespace robotcell::control
