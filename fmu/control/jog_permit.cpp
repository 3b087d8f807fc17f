#include "fmu/control/jog_permit.h"

#include <algorithm>
#include <cmath>

#include "fmu/control/jog.h"

namespace robotcell::control {
namespace {

constexpr double kSameDirection = 1e-9;

Axes scaled(const Axes& axes, double factor) {
  Axes result;
  for (std::size_t i = 0; i < kAxes; ++i) result[i] = factor * axes[i];
  return result;
}

double largest(const Axes& axes) {
  double largest = 0;
  for (const double value : axes) largest = std::max(largest, std::abs(value));
  return largest;
}

}  // namespace

Axes JogPermit::read(const Command& command, bool at_rest, std::int64_t now_us, GuardWatch& guard) {
  const Axes wanted = Jog::deflection(command);
  const double size = largest(wanted);
  if (size == 0) {
    withdraw();
    return {};
  }
  const Axes unit = scaled(wanted, 1 / size);
  bool same = command.mode == mode && command.jog_frame == frame;
  for (std::size_t i = 0; i < kAxes; ++i) same = same && std::abs(unit[i] - direction[i]) <= kSameDirection;
  if (!same) {
    withdraw();
    if (guard.guarded && !at_rest) return {};
    mode = command.mode;
    frame = command.jog_frame;
    direction = unit;
  }
  if (!guard.guarded) {
    deflection = proposed = size;
    return wanted;
  }
  const bool refused = !(command.monitor_speed > 0);
  deflection = refused ? 0 : std::min(deflection, size);
  if (waits() && !guard.waits()) {
    if (!refused) deflection = std::min(proposed, size);
    proposed = deflection;
  }
  if (size > deflection && !waits()) {
    proposed = size;
    guard.path_us = now_us;
  }
  return scaled(direction, deflection);
}

Command JogPermit::shown() const {
  Command command;
  command.mode = mode;
  command.jog_frame = frame;
  command.jog = scaled(direction, std::max(deflection, proposed));
  return command;
}

}  // namespace robotcell::control
