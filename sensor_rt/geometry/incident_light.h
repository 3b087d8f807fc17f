// Light from one point of an emitter.
#pragma once

#include <Eigen/Dense>

namespace sensor_rt {

/// Light that arrives at a surface point from one point of an emitter, without shadows. Emitters are the
/// laser sheet (LaserEmitter) and the lamps (LightSample).
struct IncidentLight {
  Eigen::Vector3d towards = Eigen::Vector3d::Zero();  ///< unit vector to the emitter
  double irradiance = 0.0;                            ///< on a surface normal to it, W/m²
};

}  // namespace sensor_rt
