#include "fmu/control/guard_watch.h"

#include <algorithm>

#include "fmu/control/command.h"
#include "fmu/control/time_units.h"

namespace robotcell::control {

double share_of_guard(double age, double max_age) { return std::clamp(2 * (1 - age / max_age), 0.0, 1.0); }

double GuardWatch::age(std::int64_t now_us) const {
  return static_cast<double>(now_us - answered_us) * kSecondsPerMicrosecond;
}

bool GuardWatch::read(std::int64_t now_us, double cycle, const Command& command, bool resets) {
  if (command.guard_us <= now_us) answered_us = std::max(answered_us, command.guard_us);
  guarded = command.guard_max_age > 0;
  const bool too_old = guarded && age(now_us) > command.guard_max_age;
  share = guarded ? share_of_guard(age(now_us) + cycle, command.guard_max_age) : 1;
  if (resets && !too_old) stopped = false;
  return too_old;
}

}  // namespace robotcell::control
