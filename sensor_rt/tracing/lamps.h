// Direct illumination by lamps.
#pragma once

#include "sensor_rt/tracing/incoherent_rays.h"
#include "sensor_rt/tracing/surface_point.h"

namespace sensor_rt {

/// Direct light of the scene's lamps.
class Lamps {
 public:
  /// `filter`: band-pass of the camera; results are relative to laser light.
  Lamps(const Band& filter, double laser_wavelength);

  /// All three objects must outlive their use here.
  void set(const Scene& scene, const PoseTrack& track, const IncoherentRays& incoherent_rays) {
    scene_ = &scene;
    track_ = &track;
    incoherent_rays_ = &incoherent_rays;
  }
  bool any() const { return !scene_->lights().empty(); }

  /// Returns the light reflected at a point towards the ray's origin, with shadows, as the equivalent
  /// irradiance on a white diffuse surface. Area lights are integrated with 16 samples.
  double brightness(const SurfacePoint& at, const Bsdf& brdf, std::size_t instant) const;

  /// Returns the contribution of a random sample of lamp `number`, without shadows, and the vector to the
  /// sample: the caller has to test it for occlusion up to t = 1.
  double sample(std::size_t number, const SurfacePoint& at, const Bsdf& brdf, std::size_t instant, double u,
                double v, Eigen::Vector3d& to_light) const;

 private:
  Band filter_;
  double laser_wavelength_;
  const Scene* scene_ = nullptr;
  const PoseTrack* track_ = nullptr;
  const IncoherentRays* incoherent_rays_ = nullptr;
};

}  // namespace sensor_rt
