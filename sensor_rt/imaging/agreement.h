// Cameras against one another: a laser ray meets one surface point first, and every camera that sees it must
// see it there. Reflections of the stripe reach the cameras from off the sheet, so that each camera
// triangulates them to a different place. Internal to imaging.
#pragma once

#include <vector>

#include "sensor_rt/imaging/choose.h"
#include "sensor_rt/imaging/extract.h"

namespace sensor_rt {

/// Fills in the standing of every peak.
///
/// - Confirmed: its point on the sheet, seen by another camera, lies within `tolerance_px` plus four standard
///   deviations of a peak there.
/// - Contradicted: not confirmed, and its laser ray holds a confirmed point already, elsewhere; or another
///   camera shows a peak close by but not there; or another camera that should see it shows peaks elsewhere
///   on the ray; or its point lies outside the range.
/// - Uncontested: the rest, and peaks that continue a stripe that is confirmed for the most part (another
///   camera's view of them is blocked).
void compare_cameras(std::vector<CameraPeaks>& peaks, const SheetGeometry& geometry, double tolerance_px);

}  // namespace sensor_rt
