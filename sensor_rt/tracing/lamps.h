// Direct illumination by lamps.
#pragma once

#include <array>

#include "sensor_rt/scene/light_parts.h"
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
  /// irradiance on a white diffuse surface. An area light is divided until 16 samples of each part suffice:
  /// it is small for its distance, and for the distance of its half vectors from the normal.
  double brightness(const SurfacePoint& at, const Bsdf& brdf, std::size_t instant) const;

  /// A random direction in which a lamp may be seen.
  struct Sample {
    double light = 0.0;  ///< contribution without shadows: the caller has to test `to_light` for occlusion
    Eigen::Vector3d to_light = Eigen::Vector3d::Zero();  ///< up to the lamp
  };

  /// Returns a random sample of lamp `number`, chosen on the lamp by two uniform numbers. The sum with
  /// sample_reflection, weighted by the balance heuristic (Veach 1997), has the expectation of the light.
  Sample sample(std::size_t number, const SurfacePoint& at, const Bsdf& brdf, std::size_t instant, double u,
                double v) const;

  /// Returns one that three uniform numbers choose by the reflection of the surface; empty where it misses
  /// the lamp, and for lamps and surfaces that do not need it.
  Sample sample_reflection(std::size_t number, const SurfacePoint& at, const Bsdf& brdf, std::size_t instant,
                           const std::array<double, 3>& u) const;

 private:
  struct AreaLight;

  double visible(const SurfacePoint& at, std::size_t instant, const LightSample* samples, const double* light,
                 int count) const;
  double integral(const AreaLight& lamp, const LightPart& part, int divisions) const;

  SceneQuery query_;
  Band filter_;
  double laser_wavelength_;
};

}  // namespace sensor_rt
