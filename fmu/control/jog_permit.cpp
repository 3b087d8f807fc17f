#include "fmu/control/jog_permit.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "fmu/control/jog.h"

namespace robotcell::control {
namespace {

constexpr double kSameDirection = 1e-9;
constexpr double kShown = 4;          // times the speed of a jog, at which its path is shown
constexpr double kLeastShown = 0.05;  // share of the full speed

Axes scaled(const Axes& axes, double factor) {
  Axes result;
  for (std::size_t i = 0; i < kAxes; ++i) result[i] = factor * axes[i];
  return result;
}

double shown_speed(double share) { return std::clamp(kShown * share, kLeastShown, 1.0); }

}  // namespace

Command JogPermit::read(const Command& command, bool at_rest, std::int64_t now_us, GuardWatch& guard) {
  Command permitted = command;
  permitted.monitor_speed = 1;
  permitted.jog = Jog::deflection(command);
  const double share = Jog::share_of_full(command.mode, permitted.jog);
  double kept = std::exchange(given, 0);  // while it waits
  if (share == 0) {
    if (at_rest) withdraw();
    return permitted;
  }
  const Axes full = scaled(permitted.jog, 1 / share);
  bool same = command.mode == mode && command.jog_frame == frame;
  for (std::size_t i = 0; i < kAxes; ++i) same = same && std::abs(full[i] - direction[i]) <= kSameDirection;
  if (!same) {
    if (guard.guarded && !at_rest) {
      permitted.jog = {};
      return permitted;
    }
    mode = command.mode;
    frame = command.jog_frame;
    direction = full;
    speed = guard.guarded ? shown_speed(share) : 1;
    kept = 0;
    guard.path_us = now_us;
  } else if (guard.guarded && share > speed && !guard.waits()) {
    speed = shown_speed(share);
    guard.path_us = now_us;
  }
  if (!guard.guarded) return permitted;
  permitted.monitor_speed = guard.waits() ? kept / speed : command.monitor_speed;
  given = std::min(share, permitted.monitor_speed * speed);
  permitted.jog = scaled(direction, given);
  return permitted;
}

Command JogPermit::shown() const {
  Command command;
  command.mode = mode;
  command.jog_frame = frame;
  command.jog = scaled(direction, speed);
  return command;
}

}  // namespace robotcell::control
