#include "sensor_rt/render/exposure_views.h"

#include <algorithm>

namespace sensor_rt {

void ExposureViews::set(const RenderPlan& plan, const SceneQuery& new_query) {
  query = new_query;
  const std::size_t samples = plan.pattern.size();
  lane_instants.resize(plan.pattern.padded_size());
  for (std::size_t i = 0; i < lane_instants.size(); ++i) {
    lane_instants[i] = query.track().instants() > 1 ? plan.pattern.instant[std::min(i, samples - 1)] : 0;
  }
  laser.set(query, plan.lane_sources, lane_instants, plan.laser_region);
  cameras.resize(plan.settings.model.cameras.size());
  const bool lamps = !query.scene().lights().empty();
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    cameras[c].set(query, plan.lane_viewpoints[c], lane_instants,
                   lamps ? plan.camera_fields[c] : plan.camera_regions[c]);
  }
}

}  // namespace sensor_rt
