#include "sensor_rt/fan/fan_caster.h"

#include <cmath>
#include <limits>

#include "sensor_rt/optics/region.h"

namespace sensor_rt {
namespace {

/// A view is free when nothing stands before this share of the way to the point; the rest is the surface
/// itself.
constexpr double kBeforeSurface = 1.0 - 1e-4;

}  // namespace

void FanPoints::clear() {
  camera.clear();
  pixel.clear();
  point.clear();
  brightness.clear();
}

FanCaster::FanCaster(const FanGeometry& geometry) : geometry_(geometry) {
  const int packets = (geometry_.rays + kLanes - 1) / kLanes;
  directions_.resize(static_cast<std::size_t>(packets));
  landings_.resize(directions_.size());
  for (int i = 0; i < packets * kLanes; ++i) {
    const double angle = geometry_.laser.fan_half_angle * (2.0 * (i + 0.5) / geometry_.rays - 1.0);
    Lanes3& packet = directions_[static_cast<std::size_t>(i / kLanes)];
    packet.x[i % kLanes] = 0.0;
    packet.y[i % kLanes] = std::sin(angle);
    packet.z[i % kLanes] = std::cos(angle);
    landings_[static_cast<std::size_t>(i / kLanes)].valid[i % kLanes] = 0;
  }
  laser_region_ = laser_region(geometry_.laser, 0.0);
  for (const Camera& camera : geometry_.cameras) camera_regions_.push_back(camera_region(camera, 1e-9));
}

void FanCaster::cast(const Scene& scene, const Exposures& exposures, std::size_t exposure, FanPoints& out) {
  static const std::vector<double> kMiddle{0.5};
  static const std::vector<std::size_t> kOneInstant(kLanes, 0);
  out.clear();
  track_.set(scene, exposures, exposure, kMiddle);
  const Eigen::Vector3d source(0.0, 0.0, geometry_.laser.source_z);
  laser_view_.set(scene, track_, source, kOneInstant, laser_region_);
  if (laser_view_.empty()) return;
  land(scene);
  for (std::size_t k = 0; k < geometry_.cameras.size(); ++k) {
    const Eigen::Vector3d centre = geometry_.cameras[k].sensor_from_camera.translation;
    camera_view_.set(scene, track_, centre, kOneInstant, camera_regions_[k]);
    see(static_cast<int>(k), out);
  }
}

void FanCaster::land(const Scene& scene) {
  for (std::size_t p = 0; p < directions_.size(); ++p) {
    const Lanes3& d = directions_[p];
    Landing& landing = landings_[p];
    alignas(64) int valid[kLanes];
    for (int l = 0; l < kLanes; ++l) valid[l] = static_cast<int>(p) * kLanes + l < geometry_.rays ? -1 : 0;
    PacketHits hits;
    laser_view_.intersect(0, d, valid, std::numeric_limits<double>::infinity(), hits);
    for (int l = 0; l < kLanes; ++l) {
      landing.valid[l] = 0;
      if (hits.shape[l] < 0) continue;
      const double z = geometry_.laser.source_z + hits.t[l] * d.z[l];
      const double facing = hits.normal.y[l] * d.y[l] + hits.normal.z[l] * d.z[l];
      if (!(z >= geometry_.near && z <= geometry_.far) || facing == 0.0) continue;
      const double sign = facing > 0.0 ? -1.0 : 1.0;
      landing.valid[l] = -1;
      landing.point.x[l] = 0.0;
      landing.point.y[l] = hits.t[l] * d.y[l];
      landing.point.z[l] = z;
      landing.normal.x[l] = sign * hits.normal.x[l];
      landing.normal.y[l] = sign * hits.normal.y[l];
      landing.normal.z[l] = sign * hits.normal.z[l];
      landing.brightness[l] =
          scene.shapes()[static_cast<std::size_t>(hits.shape[l])].reflectance * std::abs(facing);
    }
  }
}

void FanCaster::see(int number, FanPoints& out) {
  const Camera& camera = geometry_.cameras[static_cast<std::size_t>(number)];
  const Rigid3 camera_from_sensor = camera.sensor_from_camera.inverse();
  const Eigen::Vector3d centre = camera.sensor_from_camera.translation;
  const std::size_t packets = landings_.size();
  for (std::size_t step = 0; step < packets; ++step) {
    // Columns run along -y for side +1 and along +y for side -1.
    const Landing& landing = landings_[camera.side > 0 ? packets - 1 - step : step];
    alignas(64) int open[kLanes];
    Lanes3 direction;
    Eigen::Vector2d pixels[kLanes];
    bool any = false;
    for (int l = 0; l < kLanes; ++l) {
      open[l] = 0;
      direction.x[l] = direction.y[l] = direction.z[l] = 0.0;
      if (landing.valid[l] == 0) continue;
      const Eigen::Vector3d point(landing.point.x[l], landing.point.y[l], landing.point.z[l]);
      const Eigen::Vector3d normal(landing.normal.x[l], landing.normal.y[l], landing.normal.z[l]);
      const Eigen::Vector3d d = point - centre;
      const Eigen::Vector3d in_camera = camera_from_sensor * point;
      if (!(normal.dot(d) < 0.0) || !(in_camera.z() > 0.0)) continue;
      pixels[l] = camera.project(in_camera);
      if (!(pixels[l].x() >= -0.5 && pixels[l].x() < camera.width_px - 0.5)) continue;
      if (!(pixels[l].y() >= -0.5 && pixels[l].y() < camera.height_px - 0.5)) continue;
      open[l] = -1;
      any = true;
      direction.x[l] = d.x();
      direction.y[l] = d.y();
      direction.z[l] = d.z();
    }
    if (!any) continue;
    camera_view_.occlude(0, direction, kBeforeSurface, open);
    for (int i = 0; i < kLanes; ++i) {
      const int l = camera.side > 0 ? kLanes - 1 - i : i;
      if (open[l] == 0) continue;
      out.camera.push_back(number);
      out.pixel.push_back(pixels[l]);
      out.point.emplace_back(landing.point.x[l], landing.point.y[l], landing.point.z[l]);
      out.brightness.push_back(landing.brightness[l]);
    }
  }
}

}  // namespace sensor_rt
