#include "sensor_rt/optics/trapezoid.h"

#include <cmath>
#include <stdexcept>

namespace sensor_rt {

Trapezoid range_trapezoid(const Camera& camera) {
  const double gamma = std::atan(0.5 * camera.height_px / camera.focal_px);
  if (camera.tilt <= gamma) {
    throw std::invalid_argument("camera " + camera.name +
                                ": tilt must exceed the vertical half angle, or it sees to infinity");
  }
  const double aspect = static_cast<double>(camera.width_px) / camera.height_px;
  const double z_near = camera.height + camera.baseline / std::tan(camera.tilt + gamma);
  const double z_far = camera.height + camera.baseline / std::tan(camera.tilt - gamma);
  const double y_near = camera.baseline * aspect * std::sin(gamma) / std::sin(camera.tilt + gamma);
  const double y_far = camera.baseline * aspect * std::sin(gamma) / std::sin(camera.tilt - gamma);
  Trapezoid corners;
  corners << -y_near, z_near, y_near, z_near, y_far, z_far, -y_far, z_far;
  return corners;
}

}  // namespace sensor_rt
