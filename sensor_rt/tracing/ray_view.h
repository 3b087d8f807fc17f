// The shapes that rays from one origin can meet, with their poses laid out for packets.
#pragma once

#include <vector>

#include "sensor_rt/geometry/half_space.h"
#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/tracing/fan_search.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// Rays that stay inside a convex region and start from an origin each lane has for itself. Shapes outside
/// the region are dropped once per exposure, the others are tried from the nearest on and only by rays that
/// reach as far as their boxes. This takes the place of a tree over the handful of bodies: nothing is rebuilt
/// when bodies move.
class RayView {
 public:
  /// `lane_instants` gives the instant of each lane, a multiple of kLanes long: packet k uses the k-th
  /// sixteen. `lane_origins` in the reference frame, one for each lane or one for all. An empty region keeps
  /// every shape.
  void set(const Scene& scene, const PoseTrack& track, const std::vector<Eigen::Vector3d>& lane_origins,
           const std::vector<std::size_t>& lane_instants, const std::vector<HalfSpace>& region);

  /// Closest hits of packet kind `packet` up to t = farthest.
  void intersect(std::size_t packet, const Lanes3& direction, const int* valid, double farthest,
                 PacketHits& hits) const;

  /// Closest hits of all rays of a fan that starts from `eye`; `search` holds scratch memory. One packet of
  /// hits per packet of the fan; the view must have been set for one instant of `track` and this eye.
  void intersect(const PoseTrack& track, const Eigen::Vector3d& eye, const Fan& fan, FanSearch& search,
                 std::vector<PacketHits>& hits) const;

  /// Closest hits of rays that are known to meet nothing before `patch`, of a shape in view. False when one
  /// misses it.
  bool meet(std::size_t packet, const Patch& patch, const Lanes3& direction, const int* valid,
            PacketHits& hits) const;

  /// Clears open[lane] for rays that are cut before t = farthest.
  void occlude(std::size_t packet, const Lanes3& direction, double farthest, int* open) const;

  /// The same for the k-th of shapes() alone.
  void occlude_by(std::size_t k, std::size_t packet, const Lanes3& direction, double farthest,
                  int* open) const;

  /// Numbers of the shapes that were kept.
  const std::vector<std::size_t>& shapes() const { return shapes_; }

  bool empty() const { return shapes_.empty(); }

 private:
  /// Of the k-th of shapes() alone, where nearer than before.
  void intersect_with(std::size_t k, std::size_t packet, const Lanes3& direction, const int* valid,
                      PacketHits& hits) const;

  const Scene* scene_ = nullptr;
  std::size_t packets_ = 0;
  std::vector<std::size_t> shapes_;
  std::vector<LaneTransform> transforms_;  ///< [shape in view][packet]
  std::vector<double> nearest_;            ///< m: no ray of [shape in view][packet] meets it before
  std::vector<std::size_t> order_;         ///< of the shapes in view, the nearest first
};

/// Lays one pose into one lane.
void set_lane(LaneTransform& transform, int lane, const Rigid3& shape_from_reference,
              const Eigen::Vector3d& origin);

}  // namespace sensor_rt
