// Watch over the age of the messages of a guard.
#pragma once

#include <cstdint>

namespace robotcell::control {

struct Command;

/// Share of the monitor speed for an age of the last guard message: 1 up to half of `max_age`, from there
/// falling linearly to 0 at `max_age`.
double share_of_guard(double age, double max_age);

struct GuardWatch {
  std::int64_t answered_us = 0;  // instant of the latest state that a message has answered
  double share = 1;              // share of the monitor speed that is allowed at the end of the cycle
  bool stopped = false;          // messages were too old for a motion; until a reset

  /// Reads a command at the start of a cycle of `cycle` seconds; returns whether the last message is too old.
  bool read(std::int64_t now_us, double cycle, const Command& command, bool resets);

  /// Age of the latest answered state at an instant, s.
  double age(std::int64_t now_us) const;
};

}  // namespace robotcell::control
