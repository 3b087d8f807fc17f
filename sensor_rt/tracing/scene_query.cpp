#include "sensor_rt/tracing/scene_query.h"

#include <limits>

#include "sensor_rt/tracing/ray_view.h"
#include "sensor_rt/tracing/trace.h"

namespace sensor_rt {
namespace {

void lay_lanes(const PoseTrack& track, std::size_t shape, const std::size_t* instants, const Lanes3& origin,
               LaneTransform& transform) {
  for (int l = 0; l < kLanes; ++l) {
    set_lane(transform, l, track.shape_from_reference(shape, instants[l]), lane(origin, l));
  }
}

}  // namespace

void SceneQuery::intersect(const std::size_t* instants, const Lanes3& origin, const Lanes3& direction,
                           const int* valid, PacketHits& hits) const {
  clear_hits(hits, std::numeric_limits<double>::infinity());
  for (std::size_t s = 0; s < scene_->shapes().size(); ++s) {
    LaneTransform transform;
    lay_lanes(*track_, s, instants, origin, transform);
    intersect_shape(scene_->shapes()[s], static_cast<std::int32_t>(s), transform, direction, valid, hits);
  }
}

void SceneQuery::occlude(const std::size_t* instants, const Lanes3& origin, const Lanes3& segment,
                         int* unoccluded) const {
  for (std::size_t s = 0; s < scene_->shapes().size(); ++s) {
    LaneTransform transform;
    lay_lanes(*track_, s, instants, origin, transform);
    occlude_by_shape(scene_->shapes()[s], transform, segment, kSegmentEnd, unoccluded);
  }
}

}  // namespace sensor_rt
