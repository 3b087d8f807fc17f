#include "sensor_rt/render/exposure_views.h"

namespace sensor_rt {

void ExposureViews::set(const RenderPlan& plan, const SceneQuery& new_query) {
  query = new_query;
  lane_instants.resize(plan.pattern.padded_size());
  for (std::size_t i = 0; i < lane_instants.size(); ++i) {
    lane_instants[i] = query.track().instants() > 1 ? plan.pattern.instant[plan.pattern.sample_of(i)] : 0;
  }
  laser.set(query, plan.lane_sources, lane_instants, plan.laser_region);
  cameras.resize(plan.settings.model.cameras.size());
  middles.resize(cameras.size());
  const std::vector<std::size_t> middle(kLanes, middle_instant());
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    const std::vector<HalfSpace>& region = plan.camera_fields[c];
    cameras[c].set(query, plan.lane_viewpoints[c], lane_instants, region);
    middles[c].set(query, {plan.settings.model.cameras[c].sensor_from_camera.translation}, middle, region);
  }
}

}  // namespace sensor_rt
