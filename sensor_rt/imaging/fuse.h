// Points that several cameras saw, put together.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/imaging/triangulate.h"
#include "sensor_rt/optics/camera.h"

namespace sensor_rt {

/// Moves the points of one frame, from `begin` on, sorted by camera and column, to the mean of what the
/// cameras saw there, weighted by the inverse variances: a point moves along the line on the sheet that its
/// column sees, to or from where that line meets the straight line between two points of another camera. The
/// points of the later camera go. Points that differ by more than `tolerance_px` and four standard deviations
/// are left alone.
void fuse(const std::vector<Camera>& cameras, double tolerance_px, std::size_t begin, Profiles& profiles);

}  // namespace sensor_rt
