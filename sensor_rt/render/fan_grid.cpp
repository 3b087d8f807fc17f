#include "sensor_rt/render/fan_grid.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

/// Pixel coordinate of what no camera sees: behind it, or so far outside that a lens model means nothing.
constexpr double kOutOfSight = -1e6;

SENSOR_RT_MULTIVERSION
void project_pinhole(const double* r, const double* t, double focal, double cx, double cy, const Lanes3& p,
                     double* column, double* row) {
  for (int l = 0; l < kLanes; ++l) {
    const double x = r[0] * p.x[l] + r[1] * p.y[l] + r[2] * p.z[l] + t[0];
    const double y = r[3] * p.x[l] + r[4] * p.y[l] + r[5] * p.z[l] + t[1];
    const double z = r[6] * p.x[l] + r[7] * p.y[l] + r[8] * p.z[l] + t[2];
    const bool seen = z > 1e-6;
    column[l] = seen ? focal * x / z + cx : kOutOfSight;
    row[l] = seen ? focal * y / z + cy : kOutOfSight;
  }
}

}  // namespace

void FanLandings::resize(std::size_t rays, std::size_t cameras) {
  landing.resize(rays);
  column.resize(rays * cameras);
  row.resize(rays * cameras);
}

FanGrid::FanGrid(const RenderPlan& plan) : plan_(plan) {
  for (const Camera& camera : plan.settings.model.cameras) {
    const Rigid3 pose = camera.sensor_from_camera.inverse();
    CameraLanes& lanes = cameras_.emplace_back();
    for (int k = 0; k < 9; ++k) lanes.rotation[k] = pose.rotation(k / 3, k % 3);
    for (int k = 0; k < 3; ++k) lanes.translation[k] = pose.translation[k];
    lanes.focal = camera.focal_px;
    lanes.cx = camera.cx_px;
    lanes.cy = camera.cy_px;
  }
}

void FanGrid::set(const Scene& scene, const PoseTrack& track) {
  lane_instants_.resize(track.instants() * kLanes);
  for (std::size_t i = 0; i < lane_instants_.size(); ++i) lane_instants_[i] = i / kLanes;
  const Eigen::Vector3d source(0.0, 0.0, plan_.settings.model.laser.source_z);
  view_.set(scene, track, source, lane_instants_, plan_.laser_region);
}

void FanGrid::cast(const std::vector<FanRay>& rays, FanLandings& out) {
  const LaserSheet& laser = plan_.settings.model.laser;
  out.resize(rays.size(), cameras_.size());
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
      landing.hit = hits.shape[l] >= 0;
      landing.across = static_cast<float>(point.x[l] / (kSheetReach * laser.sigma_at(point.z[l])));
    }
    project(point, first, lanes, out);
  }
}

void FanGrid::project(const Lanes3& point, std::size_t first, int lanes, FanLandings& out) const {
  const std::vector<Camera>& cameras = plan_.settings.model.cameras;
  for (std::size_t c = 0; c < cameras_.size(); ++c) {
    const CameraLanes& lane = cameras_[c];
    alignas(64) double column[kLanes];
    alignas(64) double row[kLanes];
    project_pinhole(lane.rotation, lane.translation, lane.focal, lane.cx, lane.cy, point, column, row);
    for (int l = 0; l < lanes; ++l) {
      const std::size_t at = (first + static_cast<std::size_t>(l)) * cameras_.size() + c;
      out.column[at] = static_cast<float>(column[l]);
      out.row[at] = static_cast<float>(row[l]);
      // A lens distorts within its field; far outside, the polynomial may fold back into the image.
      const double reach = 0.5 * (cameras[c].width_px + cameras[c].height_px);
      const bool near_field =
          std::abs(column[l] - lane.cx) < 2.0 * reach && std::abs(row[l] - lane.cy) < 2.0 * reach;
      if (!cameras[c].is_distorted() || !near_field) continue;
      const Eigen::Vector2d pixel =
          cameras[c].project({(column[l] - lane.cx) / lane.focal, (row[l] - lane.cy) / lane.focal, 1.0});
      out.column[at] = static_cast<float>(pixel.x());
      out.row[at] = static_cast<float>(pixel.y());
    }
  }
}

}  // namespace sensor_rt
