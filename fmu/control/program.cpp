#include "fmu/control/program.h"

#include <algorithm>
#include <cmath>

namespace robotcell::control {
namespace {

constexpr double kAtStart = 1e-6;        // rad: largest distance from the start of a segment
constexpr double kLimitRounding = 1e-3;  // share of a limit of speed or acceleration: rounded set-points

/// Velocities of one axis at equidistant knots for which the cubic spline through them has a continuous
/// second derivative and rests at both ends: v[k-1] + 4 v[k] + v[k+1] = 3 (p[k+1] - p[k-1]) / spacing.
void set_spline_velocities(std::vector<Knots>& knots, std::size_t axis, double spacing) {
  const std::size_t last = knots.size() - 1;
  std::vector<double> upper(knots.size(), 0.0);  // of the tridiagonal system after elimination
  const auto knot = [&knots, axis](std::size_t k) -> Knot& { return knots[k][axis]; };
  for (std::size_t k = 1; k < last; ++k) {
    const double right = 3 * (knot(k + 1).position - knot(k - 1).position) / spacing;
    const double pivot = 4 - upper[k - 1];
    upper[k] = 1 / pivot;
    knot(k).velocity = (right - knot(k - 1).velocity) / pivot;
  }
  for (std::size_t k = last; k-- > 1;) knot(k).velocity -= upper[k] * knot(k + 1).velocity;
}

bool exceeds(const Knot& from, const Knot& to, double spacing, const AxisLimits& limits) {
  constexpr double kMost = 1 + kLimitRounding;
  return std::abs(to.velocity) > kMost * limits.max_speed ||
         peak_acceleration(from, to, spacing) > kMost * limits.max_acceleration;
}

/// First fault of one axis.
PathFault fault_of_axis(const ProgramSegment& segment, std::size_t axis, double from,
                        const AxisLimits& limits) {
  const std::vector<Knots>& knots = segment.knots;
  const auto inside = [&limits, axis](const Knots& knot) {
    return knot[axis].position >= limits.min && knot[axis].position <= limits.max;
  };
  if (!(std::abs(knots.front()[axis].position - from) <= kAtStart)) return PathFault::kElsewhere;
  if (!inside(knots.back())) return PathFault::kTargetOutOfLimits;
  for (std::size_t k = 1; k < knots.size(); ++k) {
    if (!inside(knots[k])) return PathFault::kPathOutOfLimits;
    if (exceeds(knots[k - 1][axis], knots[k][axis], segment.spacing, limits)) return PathFault::kTooFast;
  }
  return PathFault::kNone;
}

}  // namespace

Axes ProgramSegment::end() const {
  Axes axes;
  for (std::size_t i = 0; i < kAxes; ++i) axes[i] = knots.back()[i].position;
  return axes;
}

Knots ProgramSegment::at(double clock) const {
  const double place = clock / spacing;
  if (place <= 0) return knots.front();
  const auto k = static_cast<std::size_t>(place);
  if (k + 1 >= knots.size()) return knots.back();
  Knots here;
  for (std::size_t i = 0; i < kAxes; ++i) {
    here[i] = cubic_between(knots[k][i], knots[k + 1][i], spacing, place - static_cast<double>(k));
  }
  return here;
}

ProgramSegment interpolated_segment(std::int32_t id, double spacing, const std::vector<Axes>& set_points) {
  ProgramSegment segment{id, spacing, std::vector<Knots>(set_points.size())};
  for (std::size_t k = 0; k < set_points.size(); ++k) {
    for (std::size_t i = 0; i < kAxes; ++i) segment.knots[k][i].position = set_points[k][i];
  }
  for (std::size_t i = 0; i < kAxes; ++i) set_spline_velocities(segment.knots, i, spacing);
  return segment;
}

std::shared_ptr<const ProgramSegment> find_segment(const std::shared_ptr<const Program>& program,
                                                   std::int32_t id) {
  if (!program) return nullptr;
  for (const ProgramSegment& segment : program->segments) {
    if (segment.id == id) return {program, &segment};
  }
  return nullptr;
}

PathReport check_segment(const ProgramSegment& segment, const Axes& from, const Limits& limits) {
  PathReport report;
  report.end = segment.end();
  for (std::size_t i = 0; i < kAxes && report.fault == PathFault::kNone; ++i) {
    report.fault = fault_of_axis(segment, i, from[i], limits[i]);
    if (report.fault != PathFault::kNone) report.axis = static_cast<int>(i) + 1;
  }
  return report;
}

}  // namespace robotcell::control
