// Packets of rays that share nothing: light between surfaces.
#pragma once

#include <cstddef>

#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// Rays with an origin and an instant each. Slower than RayView, which knows its origin beforehand.
class FreeRays {
 public:
  void set(const Scene& scene, const PoseTrack& track);

  /// Closest hits; `instants` gives the instant of each lane.
  void intersect(const std::size_t* instants, const Lanes3& origin, const Lanes3& direction, const int* valid,
                 PacketHits& hits) const;

  /// Clears open[lane] for rays that are cut before t = farthest.
  void occlude(const std::size_t* instants, const Lanes3& origin, const Lanes3& direction, double farthest,
               int* open) const;

 private:
  const Scene* scene_ = nullptr;
  const PoseTrack* track_ = nullptr;
};

}  // namespace sensor_rt
