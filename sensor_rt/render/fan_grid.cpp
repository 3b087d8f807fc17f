#include "sensor_rt/render/fan_grid.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace sensor_rt {
void FanLandings::resize(std::size_t rays, std::size_t cameras) {
  landing.resize(rays);
  column.resize(rays * cameras);
  row.resize(rays * cameras);
}

FanGrid::FanGrid(const RenderPlan& plan) : plan_(plan) {
  for (const Camera& camera : plan.settings.model.cameras) projectors_.emplace_back(camera);
}

void FanGrid::set(const Scene& scene, const PoseTrack& track) {
  lane_instants_.resize(track.instants() * kLanes);
  for (std::size_t i = 0; i < lane_instants_.size(); ++i) lane_instants_[i] = i / kLanes;
  const Eigen::Vector3d source(0.0, 0.0, plan_.settings.model.laser.source_z);
  view_.set(scene, track, source, lane_instants_, plan_.laser_region);
}

void FanGrid::cast(const std::vector<FanRay>& rays, FanLandings& out) {
  const LaserSheet& laser = plan_.settings.model.laser;
  out.resize(rays.size(), projectors_.size());
  for (std::size_t first = 0; first < rays.size(); first += kLanes) {
    const int lanes = static_cast<int>(std::min<std::size_t>(kLanes, rays.size() - first));
    Lanes3 direction;
    alignas(64) int valid[kLanes];
    for (int l = 0; l < kLanes; ++l) {
      const FanRay& ray = rays[first + static_cast<std::size_t>(std::min(l, lanes - 1))];
      direction.x[l] = ray.slope;
      direction.y[l] = std::sin(ray.angle);
      direction.z[l] = std::cos(ray.angle);
      valid[l] = l < lanes ? -1 : 0;
    }
    PacketHits hits;
    view_.intersect(rays[first].instant, direction, valid, std::numeric_limits<double>::infinity(), hits);
    Lanes3 point;
    for (int l = 0; l < kLanes; ++l) {
      const double t = hits.shape[l] >= 0 ? hits.t[l] : 1.0;
      point.x[l] = t * direction.x[l];
      point.y[l] = t * direction.y[l];
      point.z[l] = t * direction.z[l] + laser.source_z;
    }
    for (int l = 0; l < lanes; ++l) {
      Landing& landing = out.landing[first + static_cast<std::size_t>(l)];
      landing.shape = hits.shape[l];
      landing.point = Eigen::Vector3d(point.x[l], point.y[l], point.z[l]).cast<float>();
      landing.normal = Eigen::Vector3d(hits.normal.x[l], hits.normal.y[l], hits.normal.z[l]).cast<float>();
      landing.across = static_cast<float>(point.x[l] / (kSheetReach * laser.sigma_at(point.z[l])));
    }
    for (std::size_t c = 0; c < projectors_.size(); ++c) {
      alignas(64) double column[kLanes];
      alignas(64) double row[kLanes];
      projectors_[c].project(point, column, row);
      for (int l = 0; l < lanes; ++l) {
        const std::size_t at = (first + static_cast<std::size_t>(l)) * projectors_.size() + c;
        out.column[at] = static_cast<float>(column[l]);
        out.row[at] = static_cast<float>(row[l]);
      }
    }
  }
}

}  // namespace sensor_rt
