// Fusion of points that several cameras saw.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/imaging/triangulate.h"
#include "sensor_rt/optics/camera.h"

namespace sensor_rt {

/// Positions of the points along the profile, unless given by the pixel columns.
struct Sampling {
  const double* column;        ///< px, ascending within a camera
  const std::int32_t* number;  ///< consecutive for neighbouring points
};

/// Replaces the points of one frame (from `begin` on, sorted by camera and column) by the mean over the
/// cameras, weighted by the inverse variances: a point moves along the line of sight of its column on the
/// sheet, towards its intersection with the segment between two points of another camera. The points of the
/// later camera are removed. Points that differ by more than `tolerance_px` plus four standard deviations are
/// not changed. `sampling` begins with the first of the points.
void fuse(const std::vector<Camera>& cameras, const SheetSurface& sheet, double tolerance_px,
          std::size_t begin, Profiles& profiles, const Sampling* sampling = nullptr);

}  // namespace sensor_rt
