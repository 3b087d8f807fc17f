#include "fmu/control/programmed_move.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace robotcell::control {
namespace {

constexpr double kMaxAccelerationRatio = 0.999;
constexpr int kHalvings = 12;
constexpr double kArrived = 1e-9;  // s before the end of the path clock: rounding of a sum of cycles

[[noreturn]] void fail_off_path() {
  throw std::logic_error("inverse kinematics failed on a path that was checked to be regular");
}

}  // namespace

void ProgrammedMove::start(const MotionPath& path, const PathReport& report) {
  const bool nothing_to_go = std::isinf(report.profile.speed);
  state_ = {!nothing_to_go, nullptr, path, {}, {}, {}};
  if (!nothing_to_go) state_.profile = SmoothProfile::over(1, report.profile);
  state_.path.to = report.end;
}

void ProgrammedMove::start(std::shared_ptr<const ProgramSegment> segment) {
  state_ = {true, std::move(segment), {}, {}, {}, {}};
}

void ProgrammedMove::begin(double rate) {
  if (state_.end.clock == 0) state_.start = state_.end = {0, rate};
}

/// Axes at a value of the path clock, and their derivatives with respect to it.
Knots ProgrammedMove::on_path(double clock, const Axes& near) const {
  if (state_.segment) return state_.segment->at(clock);
  const ProfilePoint profile = state_.profile.at(clock);
  const auto point = state_.path.at(profile.position, arm_, near);
  if (!point) fail_off_path();
  Knots knots;
  for (std::size_t i = 0; i < kAxes; ++i) {
    knots[i] = {point->position[i], point->derivative[i] * profile.velocity};
  }
  return knots;
}

Axes ProgrammedMove::position_at(double clock, const Axes& near) const {
  if (clock >= duration()) return destination();
  if (state_.segment) return positions(state_.segment->at(clock));
  const auto position = state_.path.position_at(state_.profile.at(clock).position, arm_, near);
  if (!position) fail_off_path();
  return *position;
}

double ProgrammedMove::progress() const {
  if (!state_.segment) return state_.profile.at(state_.end.clock).position;
  return std::min(1.0, state_.end.clock / duration());
}

ClockPoint ProgrammedMove::clock_at(double s, double cycle) const {
  const Knot start{state_.start.clock, state_.start.rate};
  const Knot end{state_.end.clock, state_.end.rate};
  const Knot now = cubic_between(start, end, cycle, s);
  // In the cycle in which the end is reached the cubic may overshoot.
  return {std::min(now.position, end.position), std::max(now.velocity, 0.0)};
}

/// State at the end of a cycle in which the clock rate becomes `rate`.
struct ProgrammedMove::CycleResult {
  ClockPoint point;
  bool arrived = false;
  Knots knots{};
};

ProgrammedMove::CycleResult ProgrammedMove::cycle_result(double cycle, double rate, const Axes& near) const {
  const ClockPoint& from = state_.end;
  CycleResult cycle_result{{from.clock + cycle * (from.rate + rate) / 2, rate}, false, {}};
  if (cycle_result.point.clock >= duration() - kArrived) {
    cycle_result = {{duration(), 0}, true, {}};
    const Axes destination = this->destination();
    for (std::size_t i = 0; i < kAxes; ++i) cycle_result.knots[i] = {destination[i], 0};
    return cycle_result;
  }
  cycle_result.knots = on_path(cycle_result.point.clock, near);
  for (Knot& knot : cycle_result.knots) knot.velocity *= rate;
  return cycle_result;
}

/// Largest ratio of the acceleration of an axis to its limit in one cycle.
double ProgrammedMove::acceleration_ratio(double cycle, const Knots& present, const Knots& end) const {
  double acceleration_ratio = 0;
  for (std::size_t i = 0; i < kAxes; ++i) {
    const double max_change = peak_acceleration(present[i], end[i], cycle);
    acceleration_ratio = std::max(acceleration_ratio, max_change / limits_[i].max_acceleration);
  }
  return acceleration_ratio;
}

/// The rate approaches its target as far as the acceleration limits allow; the feasible change is found by
/// bisection. A motion whose last part is too short for a cycle of braking goes on at its rate to the end and
/// rests there for the remainder of the cycle.
CycleEnd ProgrammedMove::advance(double cycle, const RateRamp& change, const Knots& present) {
  const Axes near = positions(present);
  const double rate = state_.end.rate;
  const double max_change = change.max_slope * cycle;
  const double step = std::clamp(change.target - rate, -max_change, max_change);
  const auto allowed = [&](const CycleResult& result) {
    return acceleration_ratio(cycle, present, result.knots) <= kMaxAccelerationRatio;
  };
  CycleResult best = cycle_result(cycle, rate + step, near);
  if (step != 0 && !allowed(best)) {
    best = cycle_result(cycle, rate, near);
    double feasible = 0;
    double infeasible = 1;
    for (int i = 0; i < kHalvings; ++i) {
      const double fraction = (feasible + infeasible) / 2;
      const CycleResult next = cycle_result(cycle, rate + fraction * step, near);
      const bool possible = allowed(next);
      (possible ? feasible : infeasible) = fraction;
      if (possible) best = next;
    }
  }
  const bool arrives_within = best.arrived && !allowed(best);
  const double duration =
      arrives_within ? std::min(cycle, (this->duration() - state_.end.clock) / rate) : cycle;
  state_.start = state_.end;
  state_.end = best.point;
  state_.active = !best.arrived;
  return {best.knots, duration};
}

}  // namespace robotcell::control
