#include "fmu/control/programmed_move.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace robotcell::control {
namespace {

constexpr double kMaxAccelerationRatio = 0.999;
constexpr int kHalvings = 12;

Axes positions(const Knots& knots) {
  Axes axes;
  for (std::size_t i = 0; i < kAxes; ++i) axes[i] = knots[i].position;
  return axes;
}

}  // namespace

void ProgrammedMove::start(const MotionPath& path, const PathReport& report, double rate) {
  const bool nothing_to_go = std::isinf(report.profile.speed);
  state_ = {!nothing_to_go, path, {}, 0, rate};
  if (!nothing_to_go) state_.profile = SmoothProfile::over(1, report.profile);
  state_.path.to = report.end;
}

/// State at the end of a cycle in which the clock rate becomes `rate`.
struct ProgrammedMove::CycleResult {
  double clock = 0;
  double rate = 0;
  bool arrived = false;
  Knots knots{};
};

ProgrammedMove::CycleResult ProgrammedMove::cycle_result(double cycle, double rate, const Axes& near) const {
  CycleResult cycle_result{state_.clock + cycle * (state_.rate + rate) / 2, rate, false, {}};
  if (cycle_result.clock >= state_.profile.duration()) {
    cycle_result = {state_.profile.duration(), 0, true, {}};
    for (std::size_t i = 0; i < kAxes; ++i) cycle_result.knots[i] = {state_.path.to[i], 0};
    return cycle_result;
  }
  const ProfilePoint profile = state_.profile.at(cycle_result.clock);
  const auto point = state_.path.at(profile.position, arm_, near);
  if (!point) throw std::logic_error("inverse kinematics failed on a path that was checked to be regular");
  for (std::size_t i = 0; i < kAxes; ++i) {
    cycle_result.knots[i] = {point->position[i], point->derivative[i] * profile.velocity * rate};
  }
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
/// bisection.
Knots ProgrammedMove::advance(double cycle, const RateRamp& change, const Knots& present) {
  const Axes near = positions(present);
  const double max_change = change.max_slope * cycle;
  const double step = std::clamp(change.target - state_.rate, -max_change, max_change);
  CycleResult best = cycle_result(cycle, state_.rate + step, near);
  if (step != 0 && acceleration_ratio(cycle, present, best.knots) > kMaxAccelerationRatio) {
    best = cycle_result(cycle, state_.rate, near);
    double feasible = 0;
    double infeasible = 1;
    for (int i = 0; i < kHalvings; ++i) {
      const double fraction = (feasible + infeasible) / 2;
      const CycleResult next = cycle_result(cycle, state_.rate + fraction * step, near);
      const bool allowed = acceleration_ratio(cycle, present, next.knots) <= kMaxAccelerationRatio;
      (allowed ? feasible : infeasible) = fraction;
      if (allowed) best = next;
    }
  }
  state_.clock = best.clock;
  state_.rate = best.rate;
  state_.active = !best.arrived;
  return best.knots;
}

}  // namespace robotcell::control
