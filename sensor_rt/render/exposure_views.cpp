#include "sensor_rt/render/exposure_views.h"

#include <algorithm>

namespace sensor_rt {

void ExposureViews::set(const RenderPlan& plan, const Scene& new_scene, const PoseTrack& new_track) {
  scene = &new_scene;
  track = &new_track;
  const std::size_t samples = plan.pattern.size();
  lane_instants.resize((samples + kLanes - 1) / kLanes * kLanes);
  for (std::size_t i = 0; i < lane_instants.size(); ++i) {
    lane_instants[i] = track->instants() > 1 ? plan.pattern.instant[std::min(i, samples - 1)] : 0;
  }
  const SensorModel& model = plan.settings.model;
  laser.set(new_scene, new_track, plan.lane_sources, lane_instants, plan.laser_region);
  cameras.resize(model.cameras.size());
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    cameras[c].set(new_scene, new_track, plan.lane_viewpoints[c], lane_instants,
                   new_scene.lights().empty() ? plan.camera_regions[c] : plan.camera_fields[c]);
  }
  incoherent_rays.set(new_scene, new_track);
}

}  // namespace sensor_rt
