// The scene at the instants of an exposure, as rays see it.
#pragma once

#include <cstddef>

#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// Segments to a surface point are tested up to this fraction of their length, and secondary rays start
/// SurfacePoint::above() the surface, so that a surface does not occlude itself.
constexpr double kSegmentEnd = 1.0 - 1e-4;

/// Closest hits and occlusion of packets of sixteen rays: how all integrators trace. Lanes have individual
/// origins and instants; RayView answers the same two queries faster for origins that are known in advance.
/// Scene and poses must outlive it.
class SceneQuery {
 public:
  SceneQuery() = default;
  SceneQuery(const Scene& scene, const PoseTrack& track) : scene_(&scene), track_(&track) {}

  const Scene& scene() const { return *scene_; }
  const PoseTrack& track() const { return *track_; }
  const Bsdf& brdf(std::int32_t shape) const {
    return *scene_->shapes()[static_cast<std::size_t>(shape)].surface;
  }

  /// Finds the closest hits; `instants` gives the instant of each lane. Directions are of any length; valid:
  /// -1 for active lanes, else 0.
  void intersect(const std::size_t* instants, const Lanes3& origin, const Lanes3& direction, const int* valid,
                 PacketHits& hits) const;

  /// Clears unoccluded[lane] for segments that a shape blocks before kSegmentEnd.
  void occlude(const std::size_t* instants, const Lanes3& origin, const Lanes3& segment,
               int* unoccluded) const;

 private:
  const Scene* scene_ = nullptr;
  const PoseTrack* track_ = nullptr;
};

}  // namespace sensor_rt
