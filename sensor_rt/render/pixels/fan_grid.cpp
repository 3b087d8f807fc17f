#include "sensor_rt/render/pixels/fan_grid.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {
namespace {

template <typename T>
void extend(std::vector<T>& to, const std::vector<T>& from) {
  to.insert(to.end(), from.begin(), from.end());
}

}  // namespace

void FanHits::resize(std::size_t rays, std::size_t cameras) {
  hit.resize(rays);
  column.resize(rays * cameras);
  row.resize(rays * cameras);
  blur.resize(rays * cameras);
}

void FanHits::append(const FanHits& other) {
  extend(hit, other.hit);
  extend(column, other.column);
  extend(row, other.row);
  extend(blur, other.blur);
}

FanGrid::FanGrid(const RenderPlan& plan, const SceneQuery& query) : plan_(plan) {
  constexpr double kStep = 3.0;  // px between neighbouring points of the source
  const double source_length = plan.settings.model.laser.source_length;
  const auto steps = static_cast<int>(std::ceil(source_length / (kStep * plan.pixel_size)));
  for (int k = 0; k <= steps; ++k)
    source_y_.push_back(steps > 0 ? source_length * (1.0 * k / steps - 0.5) : 0.0);
  const std::size_t lanes = query.track().instants() * sources() * kLanes;
  std::vector<std::size_t> lane_instants(lanes);
  std::vector<Eigen::Vector3d> lane_sources(lanes);
  for (std::size_t i = 0; i < lanes; ++i) {
    lane_instants[i] = i / kLanes / sources();
    lane_sources[i] = {0.0, source_y_[i / kLanes % sources()], plan.settings.model.laser.source_z};
  }
  view_.set(query, lane_sources, lane_instants, plan.laser_region);
}

void FanGrid::cast(const std::vector<FanRay>& rays, FanHits& out) const {
  const LaserSheet& laser = plan_.laser.sheet;
  out.resize(rays.size(), plan_.projectors.size());
  for (std::size_t first = 0; first < rays.size(); first += kLanes) {
    const int lanes = static_cast<int>(std::min<std::size_t>(kLanes, rays.size() - first));
    Lanes3 direction;
    alignas(64) int valid[kLanes];
    for (int l = 0; l < kLanes; ++l) {
      const FanRay& ray = rays[first + static_cast<std::size_t>(std::min(l, lanes - 1))];
      set_lane(direction, l, plan_.laser.direction(ray.y, ray.z, ray.slope));
    }
    activate_lanes(static_cast<std::size_t>(lanes), valid);
    const double source_y = source_y_[rays[first].source];
    PacketHits hits;
    view_.intersect(rays[first].instant * sources() + rays[first].source, direction, valid, hits);
    Lanes3 point;
    for (int l = 0; l < kLanes; ++l) {
      const double t = hits.shape[l] >= 0 ? hits.t[l] : 1.0;
      point.x[l] = t * direction.x[l];
      point.y[l] = t * direction.y[l] + source_y;
      point.z[l] = t * direction.z[l] + laser.source_z;
    }
    for (int l = 0; l < lanes; ++l) {
      FanHit& fan_hit = out.hit[first + static_cast<std::size_t>(l)];
      fan_hit.shape = hits.shape[l];
      fan_hit.point = Eigen::Vector3d(point.x[l], point.y[l], point.z[l]).cast<float>();
      fan_hit.normal = Eigen::Vector3d(hits.normal.x[l], hits.normal.y[l], hits.normal.z[l]).cast<float>();
      const FanRay& ray = rays[first + static_cast<std::size_t>(l)];
      const double off_middle = hits.shape[l] >= 0 ? hits.t[l] * ray.slope : ray.slope;
      fan_hit.across = static_cast<float>(off_middle / (kSheetReach * laser.sigma_at(point.z[l])));
    }
    for (std::size_t c = 0; c < plan_.projectors.size(); ++c) {
      alignas(64) double column[kLanes];
      alignas(64) double row[kLanes];
      plan_.projectors[c].project(point, column, row);
      const Camera& camera = plan_.settings.model.cameras[c];
      const Rigid3 camera_from_reference =
          camera.has_depth_of_field() ? camera.sensor_from_camera.inverse() : Rigid3{};
      for (int l = 0; l < lanes; ++l) {
        const std::size_t at = (first + static_cast<std::size_t>(l)) * plan_.projectors.size() + c;
        out.column[at] = static_cast<float>(column[l]);
        out.row[at] = static_cast<float>(row[l]);
        const bool blurred = camera.has_depth_of_field() && column[l] != kNotVisible;
        out.blur[at] = blurred
                           ? static_cast<float>(camera.blur_radius_px(camera_from_reference * lane(point, l)))
                           : 0.0f;
      }
    }
  }
}

}  // namespace sensor_rt
