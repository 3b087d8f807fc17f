// Convex regions of the sensor frame that contain all laser light, or everything that a camera can see of it.
#pragma once

#include <vector>

#include "sensor_rt/geometry/half_space.h"
#include "sensor_rt/optics/camera.h"
#include "sensor_rt/optics/laser_sheet.h"

namespace sensor_rt {

/// Distance, m, beyond which nothing is measured: ends fields of view that are unbounded.
constexpr double kFarthest = 10.0;

/// Throws std::invalid_argument that names the radius when the distortion has no inverse in the whole image,
/// or in the margin from which blurred light reaches it.
void require_inverse(const Camera& camera);

/// Returns the region of the laser fan within `slope` (x per metre along z) of the sheet's centre.
std::vector<HalfSpace> laser_region(const LaserSheet& laser, double slope);

/// Returns the camera's field of view up to `beyond` metres behind the laser sheet: more distant surfaces are
/// neither lit by the laser nor occlude lit points.
std::vector<HalfSpace> camera_region(const Camera& camera, double beyond);

/// Returns the camera's entire field of view.
std::vector<HalfSpace> camera_field(const Camera& camera);

/// Range of sensor z over which the camera sees the sheet X = 0.
struct DepthRange {
  double near = 0.0;
  double far = 0.0;
};
DepthRange visible_depth(const Camera& camera);

}  // namespace sensor_rt
