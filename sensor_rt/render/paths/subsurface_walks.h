// Random walks of light below translucent surfaces, as ground truth.
#pragma once

#include <cstdint>

#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/paths/path_random.h"
#include "sensor_rt/tracing/surface_point.h"

namespace sensor_rt {

/// Follows sixteen paths of a pixel backwards from where light leaves: free paths between points of isotropic
/// scattering, reflections at the surface of the body, and a connection of every point of scattering to the
/// laser source through the surface, where the light is refracted. Light that leaves the body on the way is
/// lost. Bodies must be closed.
class SubsurfaceWalks {
 public:
  /// `packet`: number of the packet within a pixel; `random`: its counters from 2^16 on are used. All must
  /// outlive it.
  SubsurfaceWalks(const RenderPlan& plan, const ExposureViews& views, std::size_t packet,
                  const PathRandom& random, std::uint32_t pixel);

  /// Starts the walk of a lane at a translucent surface.
  void start(int l, const SurfacePoint& at, std::int32_t shape, double carried);

  /// Adds the laser light of each lane, as equivalent irradiance on a white diffuse surface.
  void add_light(double* light);

 private:
  void advance(std::uint32_t event);
  void connect(double* light);
  void refract_towards_source(int l, const Eigen::Vector3d& from, const Eigen::Vector3d& normal);

  const RenderPlan& plan_;
  const ExposureViews& views_;
  std::size_t packet_;
  const PathRandom& random_;
  std::uint32_t pixel_;
  Lanes3 position_;
  Lanes3 direction_;  ///< unit
  Lanes3 normal_;     ///< unit, outwards, of the surface met last
  Lanes3 towards_;    ///< from points of scattering to the surface
  alignas(64) int alive_[kLanes] = {};
  alignas(64) int scattered_[kLanes] = {};  ///< lanes at a point of scattering
  const Subsurface* medium_[kLanes] = {};
  std::int32_t shape_[kLanes] = {};
  double offset_[kLanes] = {};
  double carried_[kLanes] = {};
};

}  // namespace sensor_rt
