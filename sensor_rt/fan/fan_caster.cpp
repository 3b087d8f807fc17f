#include "sensor_rt/fan/fan_caster.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/optics/region.h"
#include "sensor_rt/tracing/lane_planes.h"

namespace sensor_rt {
namespace {

/// Computes the hit points with normals towards the light; used[lane] is 1 within near..far.
SENSOR_RT_MULTIVERSION
void locate(double source_z, double near, double far, const Lanes3& __restrict d,
            const PacketHits& __restrict hits, Lanes3& __restrict point, Lanes3& __restrict normal,
            double* __restrict cosine, double* __restrict used) {
  for (int l = 0; l < kLanes; ++l) {
    const double t = hits.t[l] < kNoHit ? hits.t[l] : 1.0;
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

/// Computes the irradiance at the centre of the sheet, and its width there. `distance`: from the source.
SENSOR_RT_MULTIVERSION
void illuminate(const LaserEmitter& laser, const double* __restrict relative_power,
                const double* __restrict cosine, const double* __restrict distance,
                const Lanes3& __restrict point, HitLight& __restrict light) {
  for (int l = 0; l < kLanes; ++l) {
    const double depth = point.z[l] - laser.sheet.source_z;
    const double variance = laser.variance(depth);
    light.sigma[l] = std::sqrt(variance);
    light.irradiance[l] = relative_power[l] * laser.peak_irradiance(cosine[l] * distance[l], variance,
                                                                    point.x[l], point.y[l], depth);
    light.normal_travel[l] = 0.0;
  }
}

/// Computes the directions from the viewpoint; seen[lane] is 1 for points in use, on front faces, within the
/// image.
SENSOR_RT_MULTIVERSION
void find_visible(const double* __restrict viewpoint, const Lanes3& __restrict point,
                  const Lanes3& __restrict normal, const double* __restrict used,
                  const double* __restrict column, const double* __restrict row, double width, double height,
                  Lanes3& __restrict direction, double* __restrict seen) {
  for (int l = 0; l < kLanes; ++l) {
    const double x = point.x[l] - viewpoint[0];
    const double y = point.y[l] - viewpoint[1];
    const double z = point.z[l] - viewpoint[2];
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

/// Returns the angle of ray i from z.
double angle_of(const FanGeometry& geometry, int i) {
  return geometry.laser.fan_half_angle * (2.0 * (i + 0.5) / geometry.rays - 1.0);
}

/// Returns the directions of all rays in packets of sixteen.
std::vector<Lanes3> directions_of(const FanGeometry& geometry) {
  const LaserEmitter laser(geometry.laser);
  const int packets = (geometry.rays + kLanes - 1) / kLanes;
  std::vector<Lanes3> directions(static_cast<std::size_t>(packets));
  for (int i = 0; i < packets * kLanes; ++i) {
    const double angle = angle_of(geometry, i);
    const Eigen::Vector3d direction = laser.direction(std::sin(angle), std::cos(angle), 0.0);
    set_lane(directions[static_cast<std::size_t>(i / kLanes)], i % kLanes,
             laser.sheet.is_straight() ? direction : direction.normalized());
  }
  return directions;
}

}  // namespace

void FanPoints::resize(std::size_t count) {
  point.resize(count);
  column.resize(count);
  row.resize(count);
  brightness.resize(count);
  camera.resize(count);
  ray.resize(count);
  height_e.resize(count);
  width.resize(count);
  background_e.resize(count);
}

FanCaster::FanCaster(const FanGeometry& geometry)
    : geometry_(geometry), laser_(geometry.laser), directions_(directions_of(geometry)), instants_{0.5} {
  const LaserSheet& laser = geometry_.laser;
  const Rigid3 sheet_from_sensor = laser.sensor_from_sheet.inverse();
  for (Camera& camera : geometry_.cameras) {
    camera.sensor_from_camera = sheet_from_sensor * camera.sensor_from_camera;
  }
  hits_.resize(directions_.size());
  hit_points_.resize(hits_.size());
  relative_power_.resize(hits_.size() * kLanes, 0.0);
  for (int i = 0; i < geometry_.rays; ++i) {
    relative_power_[static_cast<std::size_t>(i)] = laser.relative_power(angle_of(geometry_, i));
  }
  laser_region_ = laser_region(laser, 0.0);
  const double beyond = 1e-9 + laser.max_bend() * std::min(geometry_.far, kFarthest);
  for (const Camera& camera : geometry_.cameras) {
    camera_regions_.push_back(camera_region(camera, beyond));
    projectors_.emplace_back(camera);
  }
  if (!geometry_.stripes.has_value()) return;
  instants_ = {0.5, 0.0, 1.0};
  for (const Camera& camera : geometry_.cameras) {
    optics_.emplace_back(
        camera, electrons_per_irradiance(camera, laser.wavelength, geometry_.stripes->quantum_efficiency));
  }
}

void FanCaster::cast(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                     FanPoints& points) {
  static const std::vector<std::size_t> kOneInstant(kLanes, 0);
  track_.set(scene, exposures, exposure, instants_, geometry_.laser.sensor_from_sheet);
  const Eigen::Vector3d source(0.0, 0.0, geometry_.laser.source_z);
  const SceneQuery query(scene, track_);
  laser_view_.set(query, {source}, kOneInstant, laser_region_);
  if (laser_view_.empty()) return points.resize(0);
  if (geometry_.stripes.has_value()) {
    duration_ = exposures.duration[exposure];
    motion_.clear();
    if (exposures.samples > 1) find_motion(scene);
  }
  find_hits(query);
  points.resize(geometry_.cameras.size() * hit_points_.size() * kLanes);
  std::size_t count = 0;
  for (std::size_t k = 0; k < geometry_.cameras.size(); ++k) {
    const Eigen::Vector3d& viewpoint = geometry_.cameras[k].sensor_from_camera.translation;
    camera_view_.set(query, {viewpoint}, kOneInstant, camera_regions_[k]);
    count += append_visible(query, k, count, points);
  }
  points.resize(count);
}

void FanCaster::find_hits(const SceneQuery& query) {
  for (std::size_t p = 0; p < hits_.size(); ++p) {
    HitPoints& hit_points = hit_points_[p];
    PacketHits& hits = hits_[p];
    alignas(64) int valid[kLanes];
    activate_lanes(static_cast<std::size_t>(geometry_.rays) - p * kLanes, valid);
    laser_view_.intersect(0, directions_[p], valid, hits);
    alignas(64) double cosine[kLanes];
    locate(geometry_.laser.source_z, geometry_.near, geometry_.far, directions_[p], hits, hit_points.point,
           hit_points.normal, cosine, hit_points.used);
    transform(geometry_.laser.sensor_from_sheet, hit_points.point, hit_points.in_sensor);
    for (int l = 0; l < kLanes; ++l) {
      const Shape* shape =
          hits.shape[l] >= 0 ? &query.scene().shapes()[static_cast<std::size_t>(hits.shape[l])] : nullptr;
      const bool shows = shape != nullptr && !shape->surface->is_specular();
      hit_points.used[l] = shows ? hit_points.used[l] : 0.0;
      hit_points.brightness[l] =
          shows ? cosine[l] * relative_power_[p * kLanes + static_cast<std::size_t>(l)] * shape->reflectance
                : 0.0;
    }
    if (geometry_.stripes.has_value()) light(p, cosine);
  }
}

void FanCaster::light(std::size_t p, const double* cosine) {
  HitPoints& hit_points = hit_points_[p];
  const PacketHits& hits = hits_[p];
  illuminate(laser_, &relative_power_[p * kLanes], cosine, hits.t, hit_points.point, hit_points.light);
  if (motion_.empty()) return;
  for (int l = 0; l < kLanes; ++l) {
    if (hit_points.used[l] == 0.0) continue;
    const Eigen::Vector3d travel =
        motion_[static_cast<std::size_t>(hits.shape[l])].of(lane(hit_points.point, l));
    hit_points.light.normal_travel[l] = travel.dot(lane(hit_points.normal, l));
  }
}

void FanCaster::find_motion(const Scene& scene) {
  motion_.resize(scene.shapes().size());
  for (const std::size_t s : laser_view_.shapes()) {
    motion_[s] = Displacement::between(track_.shape_from_reference(s, 0), track_.shape_from_reference(s, 1),
                                       track_.shape_from_reference(s, 2));
  }
}

void FanCaster::project(std::size_t number, std::size_t p, View& view) const {
  const Camera& camera = geometry_.cameras[number];
  const HitPoints& hit_points = hit_points_[p];
  alignas(64) double seen[kLanes];
  projectors_[number].project(hit_points.point, view.column, view.row);
  find_visible(camera.sensor_from_camera.translation.data(), hit_points.point, hit_points.normal,
               hit_points.used, view.column, view.row, camera.width_px, camera.height_px, view.direction,
               seen);
  for (int l = 0; l < kLanes; ++l) view.unoccluded[l] = seen[l] > 0.0 ? -1 : 0;
  camera_view_.occlude(0, view.direction, view.unoccluded);
}

SurfacePoint FanCaster::surface_point(const SceneQuery& query, std::size_t p, int l, const View& view) const {
  const auto shape = static_cast<std::size_t>(hits_[p].shape[l]);
  return {query.scene().shapes()[shape], query.track().shape_from_reference(shape, 0),
          lane(hit_points_[p].point, l), lane(hit_points_[p].normal, l),
          -lane(view.direction, l).normalized()};
}

double FanCaster::lamp_light(const SceneQuery& query, std::size_t p, const View& view) const {
  const Lamps lamps(query, geometry_.stripes->band_pass, geometry_.laser.wavelength);
  if (!lamps.any()) return 0.0;
  // Evaluated at one point per packet: lamps only contribute to the background here.
  const auto unoccluded = [&](int l) { return view.unoccluded[l] != 0; };
  int l = kLanes / 2;
  for (int k = 0; k < kLanes && !unoccluded(l); ++k) l = (l + 1) % kLanes;
  return lamps.brightness(surface_point(query, p, l, view), query.brdf(hits_[p].shape[l]), 0);
}

void FanCaster::measure_stripes(const SceneQuery& query, std::size_t number, std::size_t p, const View& view,
                                Stripes& stripes) const {
  const HitPoints& hit_points = hit_points_[p];
  StripeLanes seen;
  optics_[number].measure(view.direction, hit_points.normal, view.column, view.row, hit_points.light, seen);
  const double lamps = lamp_light(query, p, view);
  const double ambient = geometry_.stripes->ambient_irradiance;
  for (int l = 0; l < kLanes; ++l) {
    if (view.unoccluded[l] == 0) continue;
    const Shape& shape = query.scene().shapes()[static_cast<std::size_t>(hits_[p].shape[l])];
    double direct = shape.reflectance;
    double even = shape.reflectance;
    if (!shape.surface->is_lambert()) {
      const SurfacePoint at = surface_point(query, p, l, view);
      direct = shape.surface->pi_brdf(at.surface, -lane(directions_[p], l), at.back);
      even = shape.surface->albedo(at.normal.dot(at.back));
    }
    const double electrons = seen.responsivity[l] * duration_;
    stripes.height_e[l] =
        static_cast<float>(electrons * direct * hit_points.light.irradiance[l] * seen.peak_ratio[l]);
    stripes.width[l] = static_cast<float>(seen.width[l]);
    stripes.background_e[l] = static_cast<float>(electrons * (even * ambient + lamps));
  }
}

std::size_t FanCaster::append_visible(const SceneQuery& query, std::size_t number, std::size_t first,
                                      FanPoints& points) const {
  const Camera& camera = geometry_.cameras[number];
  const std::size_t packets = hit_points_.size();
  std::size_t at = first;
  for (std::size_t step = 0; step < packets; ++step) {
    // Columns increase along -y for side +1 and along +y for side -1.
    const std::size_t p = camera.side > 0 ? packets - 1 - step : step;
    const HitPoints& hit_points = hit_points_[p];
    View view;
    project(number, p, view);
    if (!any_lane(view.unoccluded)) continue;
    Stripes stripes;
    if (geometry_.stripes.has_value()) measure_stripes(query, number, p, view, stripes);
    for (int i = 0; i < kLanes; ++i) {
      const int l = camera.side > 0 ? kLanes - 1 - i : i;
      if (view.unoccluded[l] == 0) continue;
      points.point[at] = lane(hit_points.in_sensor, l);
      points.column[at] = view.column[l];
      points.row[at] = view.row[l];
      points.brightness[at] = static_cast<float>(hit_points.brightness[l]);
      points.camera[at] = static_cast<std::int32_t>(number);
      points.ray[at] = static_cast<std::int32_t>(p) * kLanes + l;
      if (geometry_.stripes.has_value()) {
        points.height_e[at] = stripes.height_e[l];
        points.width[at] = stripes.width[l];
        points.background_e[at] = stripes.background_e[l];
      }
      ++at;
    }
  }
  return at - first;
}

}  // namespace sensor_rt
