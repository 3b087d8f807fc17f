// Packets of incoherent rays, for light between surfaces.
#pragma once

#include <cstddef>

#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// Rays with individual origins and instants. Slower than RayView, whose origins are known in advance.
class IncoherentRays {
 public:
  void set(const Scene& scene, const PoseTrack& track);

  /// Finds the closest hits; `instants` gives the instant of each lane.
  void intersect(const std::size_t* instants, const Lanes3& origin, const Lanes3& direction, const int* valid,
                 PacketHits& hits) const;

  /// Clears unoccluded[lane] for rays that are blocked before t = farthest.
  void occlude(const std::size_t* instants, const Lanes3& origin, const Lanes3& direction, double farthest,
               int* unoccluded) const;

 private:
  const Scene* scene_ = nullptr;
  const PoseTrack* track_ = nullptr;
};

}  // namespace sensor_rt
