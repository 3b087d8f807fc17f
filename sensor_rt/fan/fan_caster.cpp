#include "sensor_rt/fan/fan_caster.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/optics/region.h"
#include "sensor_rt/tracing/lane_planes.h"

namespace sensor_rt {
namespace {

/// A view is free when nothing stands before this share of the way to the point; the rest is the surface
/// itself.
constexpr double kBeforeSurface = 1.0 - 1e-4;

constexpr double kNone = std::numeric_limits<double>::infinity();

/// Landing points with their normals turned towards the light; used[lane] is 1 within near..far.
SENSOR_RT_MULTIVERSION
void locate(double source_z, double near, double far, const Lanes3& __restrict d,
            const PacketHits& __restrict hits, Lanes3& __restrict point, Lanes3& __restrict normal,
            double* __restrict cosine, double* __restrict used) {
  for (int l = 0; l < kLanes; ++l) {
    const double t = hits.t[l] < kNone ? hits.t[l] : 1.0;
    const double z = source_z + t * d.z[l];
    const double facing = hits.normal.x[l] * d.x[l] + hits.normal.y[l] * d.y[l] + hits.normal.z[l] * d.z[l];
    const double sign = facing > 0.0 ? -1.0 : 1.0;
    const double beyond_near = z >= near ? 1.0 : 0.0;
    const double before_far = z <= far ? 1.0 : 0.0;
    used[l] = beyond_near * before_far;
    cosine[l] = std::abs(facing);
    point.x[l] = t * d.x[l];
    point.y[l] = t * d.y[l];
    point.z[l] = z;
    normal.x[l] = sign * hits.normal.x[l];
    normal.y[l] = sign * hits.normal.y[l];
    normal.z[l] = sign * hits.normal.z[l];
  }
}

/// Directions from the eye; seen[lane] is 1 for points in use, on surfaces that face the eye, within the
/// image.
SENSOR_RT_MULTIVERSION
void face(const double* __restrict eye, const Lanes3& __restrict point, const Lanes3& __restrict normal,
          const double* __restrict used, const double* __restrict column, const double* __restrict row,
          double width, double height, Lanes3& __restrict direction, double* __restrict seen) {
  for (int l = 0; l < kLanes; ++l) {
    const double x = point.x[l] - eye[0];
    const double y = point.y[l] - eye[1];
    const double z = point.z[l] - eye[2];
    const double away = normal.x[l] * x + normal.y[l] * y + normal.z[l] * z;
    const double faces = away < 0.0 ? 1.0 : 0.0;
    const double in_columns = std::abs(column[l] - 0.5 * (width - 1.0)) < 0.5 * width ? 1.0 : 0.0;
    const double in_rows = std::abs(row[l] - 0.5 * (height - 1.0)) < 0.5 * height ? 1.0 : 0.0;
    direction.x[l] = x;
    direction.y[l] = y;
    direction.z[l] = z;
    seen[l] = used[l] * faces * in_columns * in_rows;
  }
}

/// The eyes look along the reference frame's X, one way or the other.
ViewAxes looks_along(const Camera& camera) { return camera.side > 0 ? ViewAxes::kBackX : ViewAxes::kX; }

/// Of ray i from z.
double angle_of(const FanGeometry& geometry, int i) {
  return geometry.laser.fan_half_angle * (2.0 * (i + 0.5) / geometry.rays - 1.0);
}

Fan fan_of(const FanGeometry& geometry) {
  const LaserSheet& laser = geometry.laser;
  const int packets = (geometry.rays + kLanes - 1) / kLanes;
  std::vector<Lanes3> directions(static_cast<std::size_t>(packets));
  for (int i = 0; i < packets * kLanes; ++i) {
    const double angle = angle_of(geometry, i);
    const double bend = laser.bend_at(std::tan(angle) / std::tan(laser.fan_half_angle));
    const Eigen::Vector3d way(bend * std::cos(angle), std::sin(angle), std::cos(angle));
    set_lane(directions[static_cast<std::size_t>(i / kLanes)], i % kLanes,
             laser.is_straight() ? way : way.normalized());
  }
  return {std::move(directions), static_cast<std::size_t>(geometry.rays)};
}

}  // namespace

void FanPoints::resize(std::size_t count) {
  point.resize(count);
  column.resize(count);
  row.resize(count);
  brightness.resize(count);
  camera.resize(count);
}

FanCaster::FanCaster(const FanGeometry& geometry) : geometry_(geometry), fan_(fan_of(geometry)) {
  const LaserSheet& laser = geometry_.laser;
  const Rigid3 sheet_from_sensor = laser.sensor_from_sheet.inverse();
  for (Camera& camera : geometry_.cameras) {
    camera.sensor_from_camera = sheet_from_sensor * camera.sensor_from_camera;
  }
  hits_.resize(fan_.directions().size());
  landings_.resize(hits_.size());
  views_.resize(hits_.size());
  relative_power_.resize(hits_.size() * kLanes, 0.0);
  for (int i = 0; i < geometry_.rays; ++i) {
    relative_power_[static_cast<std::size_t>(i)] = laser.relative_power(angle_of(geometry_, i));
  }
  laser_region_ = laser_region(laser, 0.0);
  constexpr double kFarthest = 10.0;  // m
  const double beyond = 1e-9 + laser.largest_bend() * std::min(geometry_.far, kFarthest);
  for (const Camera& camera : geometry_.cameras) {
    camera_regions_.push_back(camera_region(camera, beyond));
    projectors_.emplace_back(camera);
  }
}

void FanCaster::cast(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                     FanPoints& points) {
  static const std::vector<double> kMiddle{0.5};
  static const std::vector<std::size_t> kOneInstant(kLanes, 0);
  track_.set(scene, exposures, exposure, kMiddle, geometry_.laser.sensor_from_sheet);
  const Eigen::Vector3d source(0.0, 0.0, geometry_.laser.source_z);
  laser_view_.set(scene, track_, {source}, kOneInstant, laser_region_);
  if (laser_view_.empty()) return points.resize(0);
  land(scene);
  points.resize(geometry_.cameras.size() * landings_.size() * kLanes);
  std::size_t count = 0;
  for (std::size_t k = 0; k < geometry_.cameras.size(); ++k) {
    const Camera& camera = geometry_.cameras[k];
    const Eigen::Vector3d eye = camera.sensor_from_camera.translation;
    camera_view_.set(scene, track_, {eye}, kOneInstant, camera_regions_[k]);
    look(k);
    sight_lines_.set(scene, track_, camera_view_.shapes(), {source, eye, looks_along(camera), 0}, bundles_);
    count += see(k, count, points);
  }
  points.resize(count);
}

void FanCaster::land(const Scene& scene) {
  laser_view_.intersect(track_, {0.0, 0.0, geometry_.laser.source_z}, fan_, search_, hits_);
  for (std::size_t p = 0; p < hits_.size(); ++p) {
    Landing& landing = landings_[p];
    const PacketHits& hits = hits_[p];
    alignas(64) double cosine[kLanes];
    locate(geometry_.laser.source_z, geometry_.near, geometry_.far, fan_.directions()[p], hits, landing.point,
           landing.normal, cosine, landing.used);
    transform(geometry_.laser.sensor_from_sheet, landing.point, landing.in_sensor);
    for (int l = 0; l < kLanes; ++l) {
      const bool hit = hits.shape[l] >= 0;
      landing.used[l] = hit ? landing.used[l] : 0.0;
      landing.brightness[l] = hit ? cosine[l] * relative_power_[p * kLanes + static_cast<std::size_t>(l)] *
                                        scene.shapes()[static_cast<std::size_t>(hits.shape[l])].reflectance
                                  : 0.0;
    }
  }
}

void FanCaster::look(std::size_t number) {
  const Camera& camera = geometry_.cameras[number];
  const Eigen::Vector3d eye = camera.sensor_from_camera.translation;
  const std::size_t packets_per_bundle = (landings_.size() + Windows::kMost - 1) / Windows::kMost;
  bundles_.clear();
  Window bundle;
  for (std::size_t p = 0; p < landings_.size(); ++p) {
    const Landing& landing = landings_[p];
    View& view = views_[p];
    alignas(64) double seen[kLanes];
    projectors_[number].project(landing.point, view.column, view.row);
    face(eye.data(), landing.point, landing.normal, landing.used, view.column, view.row, camera.width_px,
         camera.height_px, view.direction, seen);
    view.window = window_of(view.direction, looks_along(camera), seen);
    bundle.include(view.window);
    if ((p + 1) % packets_per_bundle == 0 || p + 1 == landings_.size()) {
      bundles_.add(bundle);
      bundle = Window();
    }
    for (int l = 0; l < kLanes; ++l) view.open[l] = seen[l] > 0.0 ? -1 : 0;
  }
}

std::size_t FanCaster::see(std::size_t number, std::size_t first, FanPoints& points) {
  const Camera& camera = geometry_.cameras[number];
  const std::size_t packets = landings_.size();
  std::size_t at = first;
  for (std::size_t step = 0; step < packets; ++step) {
    // Columns run along -y for side +1 and along +y for side -1.
    const std::size_t p = camera.side > 0 ? packets - 1 - step : step;
    const Landing& landing = landings_[p];
    View& view = views_[p];
    if (view.window.empty()) continue;
    sight_lines_.occlude(camera_view_, 0, view.direction, view.window, kBeforeSurface, view.open);
    for (int i = 0; i < kLanes; ++i) {
      const int l = camera.side > 0 ? kLanes - 1 - i : i;
      if (view.open[l] == 0) continue;
      points.point[at] = lane(landing.in_sensor, l);
      points.column[at] = static_cast<std::int32_t>(std::floor(view.column[l] + 0.5));
      points.row[at] = view.row[l];
      points.brightness[at] = static_cast<float>(landing.brightness[l]);
      points.camera[at] = static_cast<std::int32_t>(number);
      ++at;
    }
  }
  return at - first;
}

}  // namespace sensor_rt
