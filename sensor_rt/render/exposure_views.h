// The scene at the instants of one exposure, shared by all kinds of light.
#pragma once

#include <vector>

#include "sensor_rt/render/render_plan.h"
#include "sensor_rt/tracing/incoherent_rays.h"
#include "sensor_rt/tracing/ray_view.h"

namespace sensor_rt {

/// Packet k of every view uses entries 16 k .. 16 k + 15 of lane_instants.
struct ExposureViews {
  const Scene* scene = nullptr;
  const PoseTrack* track = nullptr;
  std::vector<std::size_t> lane_instants;  ///< of the samples of a pixel, padded to whole packets
  RayView laser;
  std::vector<RayView> cameras;
  IncoherentRays incoherent_rays;

  void set(const RenderPlan& plan, const Scene& new_scene, const PoseTrack& new_track);
  std::size_t packets() const { return lane_instants.size() / kLanes; }
  const Bsdf& brdf(std::int32_t shape) const {
    return *scene->shapes()[static_cast<std::size_t>(shape)].surface;
  }
};

}  // namespace sensor_rt
