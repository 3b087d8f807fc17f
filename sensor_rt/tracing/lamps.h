// Direct illumination by lamps.
#pragma once

#include "sensor_rt/tracing/scene_query.h"
#include "sensor_rt/tracing/surface_point.h"

namespace sensor_rt {

/// Direct light of the scene's lamps.
class Lamps {
 public:
  /// `filter`: band-pass of the camera; results are relative to laser light.
  Lamps(const SceneQuery& query, const Band& filter, double laser_wavelength)
      : query_(query), filter_(filter), laser_wavelength_(laser_wavelength) {}

  bool any() const { return !query_.scene().lights().empty(); }

  /// Returns the light reflected at a point towards the ray's origin, with shadows, as the equivalent
  /// irradiance on a white diffuse surface. Area lights are integrated with 16 samples.
  double brightness(const SurfacePoint& at, const Bsdf& brdf, std::size_t instant) const;

  /// Returns the contribution of a random sample of lamp `number`, without shadows, and the vector to the
  /// sample: the caller has to test it for occlusion.
  double sample(std::size_t number, const SurfacePoint& at, const Bsdf& brdf, std::size_t instant, double u,
                double v, Eigen::Vector3d& to_light) const;

 private:
  SceneQuery query_;
  Band filter_;
  double laser_wavelength_;
};

}  // namespace sensor_rt
