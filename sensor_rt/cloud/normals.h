// Surface normals of a scanned cloud.
#pragma once

#include "sensor_rt/cloud/cloud_view.h"
#include "sensor_rt/geometry/large_vector.h"

namespace sensor_rt {

/// Returns unit normals (count, 3) towards the light; NaN where they are not determined. Three methods are
/// tried in turn until one gives a lit orientation: neighbours in the grid of profiles and columns (see
/// grid_normals); the plane fitted to the twelve nearest points, of all or of every 4th, 16th or 64th point,
/// if they are near and not collinear; and the perpendicular to the profile that is closest to the light. The
/// result does not depend on the number of threads.
LargeVector<double> estimate_normals(const CloudView& cloud, unsigned threads);

}  // namespace sensor_rt
