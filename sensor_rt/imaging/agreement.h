// Comparison of cameras: a laser ray has one closest hit, and every camera that sees it must see it there.
// Reflections of the stripe reach the cameras from points off the sheet, so that each camera triangulates
// them to a different position. Internal to imaging.
#pragma once

#include <vector>

#include "sensor_rt/imaging/choose.h"
#include "sensor_rt/imaging/extract.h"

namespace sensor_rt {

/// Sets the agreement of every peak.
///
/// - Confirmed: its point on the sheet, projected to another camera, lies within `tolerance_px` plus four
///   standard deviations of a peak there.
/// - Contradicted: not confirmed, and its laser ray has a confirmed point elsewhere; or another camera shows
/// a
///   peak nearby but not there; or another camera that should see it shows peaks elsewhere on the ray; or its
///   point lies outside the range.
/// - Uncontested: the rest, and peaks that continue a mostly confirmed stripe (occluded from another camera).
void compare_cameras(std::vector<CameraPeaks>& peaks, const SheetGeometry& geometry, double tolerance_px);

}  // namespace sensor_rt
