// Convex regions of the sensor frame that hold all light of the laser, or all that a camera can see of it.
#pragma once

#include <vector>

#include "sensor_rt/geometry/half_space.h"
#include "sensor_rt/optics/camera.h"
#include "sensor_rt/optics/laser_sheet.h"

namespace sensor_rt {

/// Rays from the source within the fan that lie within `slope` (x per metre along z) of the sheet's middle.
std::vector<HalfSpace> laser_region(const LaserSheet& laser, double slope);

/// The camera's field of view, cut off `beyond` metres behind the laser sheet: what lies further away can
/// neither be lit nor stand in front of what is lit.
std::vector<HalfSpace> camera_region(const Camera& camera, double beyond);

/// The camera's whole field of view.
std::vector<HalfSpace> camera_field(const Camera& camera);

/// Range of sensor z over which the camera sees the sheet X = 0.
struct DepthRange {
  double near = 0.0;
  double far = 0.0;
};
DepthRange visible_depth(const Camera& camera);

}  // namespace sensor_rt
