// Vectorised projection of points into a camera.
#pragma once

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/optics/camera.h"

namespace sensor_rt {

/// Coordinate of points that are not visible: behind the camera, or so far outside its field that the lens
/// model is not valid.
constexpr double kNotVisible = -1e6;

/// Camera::project for points of the sensor frame, 16 at a time.
class Projector {
 public:
  explicit Projector(const Camera& camera);

  void project(const Lanes3& points_in_sensor, double* column, double* row) const;

 private:
  Camera camera_;
  double reach2_ = 0.0;  ///< squared radius, px, up to which the lens model is valid; plain cameras: unused
  double rotation_[9];   ///< camera_from_sensor, row-major
  double translation_[3];
};

}  // namespace sensor_rt
