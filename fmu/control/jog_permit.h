// Jogs that a guard must have answered before they move the robot, at most as fast as it permits.
#pragma once

#include <cstdint>

#include "fmu/control/command.h"
#include "fmu/control/guard_watch.h"

namespace robotcell::control {

/// Holds a jog back until the guard has answered a state that shows its path, and limits its speed.
///
/// The path does not depend on the speed: it is shown at full speed. The monitor speed of the guard's last
/// answer is the largest permitted share of that. A jog in another direction begins at rest. Without a guard
/// every jog is permitted.
struct JogPermit {
  Mode mode = Mode::kJointJog;
  JogFrame frame = JogFrame::kWorld;
  Axes direction{};  // deflections of full speed; zero: no jog is shown

  /// Reads a command at the start of a cycle; returns it with the permitted deflections, and the permitted
  /// share of the full speed as monitor speed.
  Command read(const Command& command, bool at_rest, std::int64_t now_us, GuardWatch& guard);

  /// The robot leaves the path of the jog.
  void withdraw() { direction = {}; }

  /// Whether a path is shown that no answer refers to yet.
  bool waits(const GuardWatch& guard) const { return direction != Axes{} && guard.waits(); }

  /// The jog that is sent to the guard: at full speed.
  Command shown() const;
};

}  // namespace robotcell::control
