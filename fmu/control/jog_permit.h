// Jogs that a guard must have answered before they move the robot, at most as fast as it permits.
#pragma once

#include <cstdint>

#include "fmu/control/command.h"
#include "fmu/control/guard_watch.h"

namespace robotcell::control {

/// Holds a jog back until the guard has answered a state that shows its path, and limits its speed.
///
/// The path does not depend on the speed. It is shown at several times the speed of the jog, so that the
/// points of a slow one are close to each other where the axes move fast, near a singular position. The
/// monitor speed of the guard's last answer is the largest permitted share of the speed that is shown. A
/// faster jog is shown anew, and keeps its speed until that is answered; a jog in another direction begins at
/// rest. Without a guard every jog is permitted, and shown at full speed.
struct JogPermit {
  Mode mode = Mode::kJointJog;
  JogFrame frame = JogFrame::kWorld;
  Axes direction{};  // deflections of full speed; zero: no jog is shown
  double speed = 1;  // that is shown, as a share of the full speed
  double given = 0;  // share of the full speed in the last cycle

  /// Reads a command at the start of a cycle; returns it with the permitted deflections, and the permitted
  /// share of the speed that is shown as monitor speed.
  Command read(const Command& command, bool at_rest, std::int64_t now_us, GuardWatch& guard);

  /// The robot leaves the path of the jog.
  void withdraw() { direction = {}; }

  /// Whether a path is shown that no answer refers to yet.
  bool waits(const GuardWatch& guard) const { return direction != Axes{} && guard.waits(); }

  /// Largest speed of a motion that waits for an answer, as a share of the speed that is shown.
  double held(const GuardWatch& guard) const { return waits(guard) ? given / speed : 0; }

  /// The jog that is sent to the guard.
  Command shown() const;
};

}  // namespace robotcell::control
