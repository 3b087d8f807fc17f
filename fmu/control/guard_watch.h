// Watch over the messages of a guard: what they answer, and their age.
#pragma once

#include <cstdint>

namespace robotcell::control {

struct Command;

/// Share of the monitor speed for an age of the last guard message: 1 up to half of `max_age`, from there
/// falling linearly to 0 at `max_age`.
double share_of_guard(double age, double max_age);

struct GuardWatch {
  std::int64_t answered_us = 0;  // instant of the latest state that a message has answered
  std::int64_t path_us = 0;      // instant at which a path was taken up: only later states show it
  bool guarded = false;          // there is a guard
  double share = 1;              // share of the monitor speed that the age allows at the end of the cycle
  bool stopped = false;          // messages were too old for a motion; until a reset

  /// Reads a command at the start of a cycle of `cycle` seconds; returns whether the last message is too old.
  bool read(std::int64_t now_us, double cycle, const Command& command, bool resets);

  /// Whether no answered state has shown the path yet.
  bool waits() const { return guarded && answered_us <= path_us; }

  /// Share of the monitor speed at which a programmed motion may go on.
  double permitted_share() const { return stopped || waits() ? 0 : share; }

  /// Age of the latest answered state at an instant, s.
  double age(std::int64_t now_us) const;
};

}  // namespace robotcell::control
