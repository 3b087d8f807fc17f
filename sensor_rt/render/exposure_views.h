// The scene at the instants of one exposure, shared by all integrators.
#pragma once

#include <vector>

#include "sensor_rt/render/render_plan.h"
#include "sensor_rt/tracing/ray_view.h"
#include "sensor_rt/tracing/scene_query.h"

namespace sensor_rt {

/// Queries for any rays and, faster, for rays from the laser and the cameras. Packet k of every view uses
/// entries 16 k .. 16 k + 15 of lane_instants.
struct ExposureViews {
  SceneQuery query;
  std::vector<std::size_t> lane_instants;  ///< of the samples of a pixel, padded to whole packets
  RayView laser;
  std::vector<RayView> cameras;
  std::vector<RayView> middles;  ///< per camera: from the centre of the lens at mid-exposure, in packet 0

  /// Overwrites the views. Scene and poses of the query must outlive their use.
  void set(const RenderPlan& plan, const SceneQuery& new_query);

  std::size_t packets() const { return lane_instants.size() / kLanes; }
  /// Returns the instants of a packet's lanes.
  const std::size_t* instants(std::size_t packet) const { return &lane_instants[packet * kLanes]; }
  std::size_t middle_instant() const { return query.track().instants() / 2; }
  const Bsdf& brdf(std::int32_t shape) const { return query.brdf(shape); }
};

}  // namespace sensor_rt
