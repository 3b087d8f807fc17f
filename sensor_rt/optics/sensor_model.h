// The optical description of a profile sensor.
#pragma once

#include <string>
#include <vector>

#include "sensor_rt/geometry/band.h"
#include "sensor_rt/optics/camera.h"
#include "sensor_rt/optics/laser_sheet.h"

namespace sensor_rt {

/// Laser, cameras and ambient light, in SI units.
struct SensorModel {
  std::string name;
  LaserSheet laser;
  std::vector<Camera> cameras;
  double near = 0.0;                ///< measuring range along sensor z, m
  double far = 0.0;                 ///< m
  Band band_pass;                   ///< of the cameras' filters
  double ambient_irradiance = 0.0;  ///< on every surface, inside the band-pass, W/m²
};

}  // namespace sensor_rt
