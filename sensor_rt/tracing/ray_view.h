// The shapes that rays from given origins can hit, with their poses arranged for packets.
#pragma once

#include <vector>

#include "sensor_rt/geometry/half_space.h"
#include "sensor_rt/tracing/packet.h"
#include "sensor_rt/tracing/scene_query.h"

namespace sensor_rt {

/// SceneQuery for rays that stay inside a convex region and whose origins are fixed per lane: the same
/// answers. Shapes outside the region are culled once per exposure; the others are intersected front to back,
/// only where rays meet their bounding boxes. With few bodies this replaces a top-level tree, which would
/// have to be rebuilt when bodies move.
class RayView {
 public:
  /// `lane_instants` gives the instant of each lane, a multiple of kLanes long: packet k uses the k-th
  /// sixteen. `lane_origins` in the reference frame, one for each lane or one for all. An empty region keeps
  /// every shape.
  void set(const SceneQuery& query, const std::vector<Eigen::Vector3d>& lane_origins,
           const std::vector<std::size_t>& lane_instants, const std::vector<HalfSpace>& region);

  /// Finds the closest hits of packet `packet` up to t = farthest.
  void intersect(std::size_t packet, const Lanes3& direction, const int* valid, PacketHits& hits,
                 double farthest = kNoHit) const;

  /// Clears unoccluded[lane] for segments from the origins that a shape blocks before kSegmentEnd.
  void occlude(std::size_t packet, const Lanes3& segment, int* unoccluded) const;

  /// Indices of the shapes in view.
  const std::vector<std::size_t>& shapes() const { return shapes_; }

  bool empty() const { return shapes_.empty(); }

 private:
  const Scene* scene_ = nullptr;
  std::size_t packets_ = 0;
  std::vector<std::size_t> shapes_;
  std::vector<LaneTransform> transforms_;  ///< [shape in view][packet]
  std::vector<std::size_t> order_;         ///< shapes in view, nearest first
};

/// Writes a pose to a lane.
void set_lane(LaneTransform& transform, int lane, const Rigid3& shape_from_reference,
              const Eigen::Vector3d& origin);

}  // namespace sensor_rt
