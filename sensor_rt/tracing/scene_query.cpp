#include "sensor_rt/tracing/scene_query.h"

#include "sensor_rt/tracing/ray_view.h"
#include "sensor_rt/tracing/trace.h"

namespace sensor_rt {
namespace {

/// Returns a function that gives the LaneTransform of a shape for rays with individual instants and origins.
auto transforms_of(const PoseTrack& track, const std::size_t* instants, const Lanes3& origin) {
  return [&track, instants, &origin](std::size_t shape) {
    LaneTransform transform;
    for (int l = 0; l < kLanes; ++l) {
      set_lane(transform, l, track.shape_from_reference(shape, instants[l]), lane(origin, l));
    }
    return transform;
  };
}

}  // namespace

void SceneQuery::intersect(const std::size_t* instants, const Lanes3& origin, const Lanes3& direction,
                           const int* valid, PacketHits& hits) const {
  intersect_shapes(scene_->shapes(), transforms_of(*track_, instants, origin), direction, valid, hits);
}

void SceneQuery::occlude(const std::size_t* instants, const Lanes3& origin, const Lanes3& segment,
                         int* unoccluded) const {
  occlude_by_shapes(scene_->shapes(), transforms_of(*track_, instants, origin), segment, kSegmentEnd,
                    unoccluded);
}

}  // namespace sensor_rt
