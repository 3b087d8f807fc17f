// Scan programs: segments of set-points that the controller executes as a whole.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "fmu/control/motion_path.h"

namespace robotcell::control {

/// A motion from rest to rest. The parameter of its path is the path clock: the time at full monitor speed.
struct ProgramSegment {
  std::int32_t id = 0;
  double spacing = 0;        // s, between two knots
  std::vector<Knots> knots;  // at least two; at rest at both ends

  double duration() const { return spacing * static_cast<double>(knots.size() - 1); }
  Axes end() const;

  /// Axes at a value of the path clock, and their derivatives with respect to it; constant beyond the ends.
  Knots at(double clock) const;
};

/// The segment through set-points `spacing` seconds apart, at least two: the cubic spline with continuous
/// acceleration that is at rest at both ends.
ProgramSegment interpolated_segment(std::int32_t id, double spacing, const std::vector<Axes>& set_points);

struct Program {
  std::vector<ProgramSegment> segments;  // with unique ids
};

/// The segment with an id, which keeps its program alive; null where there is none.
std::shared_ptr<const ProgramSegment> find_segment(const std::shared_ptr<const Program>& program,
                                                   std::int32_t id);

/// Checks that a segment starts at `from` and keeps the limits of position, speed and acceleration at full
/// speed. The report has no profile.
PathReport check_segment(const ProgramSegment& segment, const Axes& from, const Limits& limits);

}  // namespace robotcell::control
