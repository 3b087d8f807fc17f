#include "fmu/control/programmed_move.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace robotcell::control {
namespace {

constexpr double kMostEffort = 0.999;
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

/// Where a cycle leads at whose end the clock runs at `rate`.
struct ProgrammedMove::Outcome {
  double clock = 0;
  double rate = 0;
  bool arrived = false;
  Knots knots{};
};

ProgrammedMove::Outcome ProgrammedMove::outcome(double cycle, double rate, const Axes& near) const {
  Outcome outcome{state_.clock + cycle * (state_.rate + rate) / 2, rate, false, {}};
  if (outcome.clock >= state_.profile.duration()) {
    outcome = {state_.profile.duration(), 0, true, {}};
    for (std::size_t i = 0; i < kAxes; ++i) outcome.knots[i] = {state_.path.to[i], 0};
    return outcome;
  }
  const ProfilePoint profile = state_.profile.at(outcome.clock);
  const auto point = state_.path.at(profile.position, arm_, near);
  if (!point) throw std::logic_error("the line cannot be followed although it was found to be regular");
  for (std::size_t i = 0; i < kAxes; ++i) {
    outcome.knots[i] = {point->position[i], point->slope[i] * profile.velocity * rate};
  }
  return outcome;
}

/// Greatest share of an axis' acceleration limit that the cubics to a cycle's end use.
double ProgrammedMove::effort(double cycle, const Knots& present, const Knots& end) const {
  double effort = 0;
  for (std::size_t i = 0; i < kAxes; ++i) {
    const double most = greatest_acceleration(present[i], end[i], cycle);
    effort = std::max(effort, most / limits_[i].max_acceleration);
  }
  return effort;
}

/// The rate comes as near to the wanted one as the acceleration limits allow, by halving the change.
Knots ProgrammedMove::advance(double cycle, const RateChange& change, const Knots& present) {
  const Axes near = positions(present);
  const double most = change.steepest * cycle;
  const double step = std::clamp(change.wanted - state_.rate, -most, most);
  Outcome best = outcome(cycle, state_.rate + step, near);
  if (step != 0 && effort(cycle, present, best.knots) > kMostEffort) {
    best = outcome(cycle, state_.rate, near);
    double possible = 0;
    double tried = 1;
    for (int i = 0; i < kHalvings; ++i) {
      const double share = (possible + tried) / 2;
      const Outcome next = outcome(cycle, state_.rate + share * step, near);
      const bool allowed = effort(cycle, present, next.knots) <= kMostEffort;
      (allowed ? possible : tried) = share;
      if (allowed) best = next;
    }
  }
  state_.clock = best.clock;
  state_.rate = best.rate;
  state_.active = !best.arrived;
  return best.knots;
}

}  // namespace robotcell::control
