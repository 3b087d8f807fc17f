// The scene at the instants of one exposure, as all light of that exposure needs it.
#pragma once

#include <vector>

#include "sensor_rt/render/render_plan.h"
#include "sensor_rt/tracing/free_rays.h"
#include "sensor_rt/tracing/ray_view.h"

namespace sensor_rt {

/// Packet k of every view uses the k-th sixteen of lane_instants.
struct ExposureViews {
  const Scene* scene = nullptr;
  const PoseTrack* track = nullptr;
  std::vector<std::size_t> lane_instants;  ///< of the samples of a pixel, padded to whole packets
  RayView laser;
  std::vector<RayView> cameras;
  FreeRays free;

  void set(const RenderPlan& plan, const Scene& new_scene, const PoseTrack& new_track);
  std::size_t packets() const { return lane_instants.size() / kLanes; }
  const Reflection& reflection(std::int32_t shape) const {
    return *scene->shapes()[static_cast<std::size_t>(shape)].surface;
  }
};

/// Where a ray met a surface.
struct SurfacePoint {
  Eigen::Vector3d position;
  Eigen::Vector3d normal;  ///< unit, on the side from which the ray came
  Eigen::Vector3d back;    ///< unit, towards where the ray came from

  SurfacePoint(const Lanes3& origin, const Lanes3& direction, const PacketHits& hits, int l)
      : position(lane(origin, l) + hits.t[l] * lane(direction, l)),
        normal(lane(hits.normal, l)),
        back(-lane(direction, l).normalized()) {
    if (normal.dot(back) < 0.0) normal = -normal;
  }

  /// Origin for rays that leave the surface: a micrometre above it, so that they do not meet it at once.
  Eigen::Vector3d above() const { return position + 1e-6 * normal; }
};

}  // namespace sensor_rt
