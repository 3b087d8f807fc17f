#include "sensor_rt/render/pixel_tracer.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Directions through the samples of a pixel: axes * (x, y, 1), x and y linear in the sample's offset.
SENSOR_RT_MULTIVERSION
void spread_directions(const double* __restrict axes, const double* __restrict ray,
                       const double* __restrict du, const double* __restrict dv, Lanes3& __restrict d) {
  for (int l = 0; l < kLanes; ++l) {
    const double x = ray[0] + ray[2] * du[l] + ray[3] * dv[l];
    const double y = ray[1] + ray[4] * du[l] + ray[5] * dv[l];
    d.x[l] = axes[0] * x + axes[3] * y + axes[6];
    d.y[l] = axes[1] * x + axes[4] * y + axes[7];
    d.z[l] = axes[2] * x + axes[5] * y + axes[8];
  }
}

}  // namespace

PixelTracer::PixelTracer(const RenderPlan& plan)
    : plan_(plan), sheet_(plan.settings.model.laser), camera_views_(plan.settings.model.cameras.size()) {
  const std::size_t padded = (plan.pattern.size() + kLanes - 1) / kLanes * kLanes;
  for (std::size_t i = 0; i < padded; ++i) {
    const std::size_t sample = std::min(i, plan.pattern.size() - 1);
    sample_column_.push_back(plan.pattern.column[sample]);
    sample_row_.push_back(plan.pattern.row[sample]);
  }
}

void PixelTracer::set(const Scene& scene, const PoseTrack& track) {
  scene_ = &scene;
  surfaces_.clear();
  for (const Shape& shape : scene.shapes()) {
    const bool lambert = shape.surface->material().is_lambert();
    surfaces_.push_back({shape.reflectance, lambert ? nullptr : shape.surface.get()});
  }
  lane_instants_.resize(sample_row_.size());
  for (std::size_t i = 0; i < lane_instants_.size(); ++i) {
    const std::size_t sample = std::min(i, plan_.pattern.size() - 1);
    lane_instants_[i] = track.instants() > 1 ? plan_.pattern.instant[sample] : 0;
  }
  const SensorModel& model = plan_.settings.model;
  shadow_view_.set(scene, track, {0.0, 0.0, model.laser.source_z}, lane_instants_, plan_.laser_region);
  for (std::size_t c = 0; c < model.cameras.size(); ++c) {
    const Eigen::Vector3d centre = model.cameras[c].sensor_from_camera.translation;
    camera_views_[c].set(scene, track, centre, lane_instants_, plan_.camera_regions[c]);
  }
}

void PixelTracer::select_camera(std::size_t camera) {
  number_ = camera;
  camera_ = &plan_.settings.model.cameras[camera];
  for (int k = 0; k < 9; ++k) axes_[k] = camera_->sensor_from_camera.rotation(k % 3, k / 3);
  for (int k = 0; k < 3; ++k) eye_[k] = camera_->sensor_from_camera.translation[k];
}

PixelTracer::PixelRay PixelTracer::pixel_ray(int column, int row) const {
  const double scale = 1.0 / camera_->focal_px;
  if (!camera_->is_distorted()) {
    return {(column - camera_->cx_px) * scale, (row - camera_->cy_px) * scale, scale, 0.0, 0.0, scale};
  }
  const Eigen::Vector3d middle = camera_->ray({column, row});
  const Eigen::Matrix2d slope = camera_->ray_jacobian(middle);
  return {middle.x(), middle.y(), slope(0, 0), slope(0, 1), slope(1, 0), slope(1, 1)};
}

double PixelTracer::brightness(const PacketHits& hits, int l, const Lanes3& direction,
                               const Lanes3& from_source, double irradiance) const {
  const Reflection& reflection = *surfaces_[static_cast<std::size_t>(hits.shape[l])].reflection;
  const Eigen::Vector3d to_eye = -lane(direction, l).normalized();
  Eigen::Vector3d normal = lane(hits.normal, l);
  if (normal.dot(to_eye) < 0.0) normal = -normal;
  double sum = plan_.settings.model.ambient_irradiance * reflection.albedo(normal.dot(to_eye));
  if (irradiance > 0.0) {
    const Eigen::Vector3d to_source = -lane(from_source, l).normalized();
    sum += irradiance * reflection.diffuse_equivalent(normal, to_source, to_eye);
  }
  return sum;
}

double PixelTracer::sum_packet(std::size_t packet, const Lanes3& direction, const int* valid) {
  PacketHits hits;
  camera_views_[number_].intersect(packet, direction, valid, kInfinity, hits);
  Lanes3 from_source;
  alignas(64) double irradiance[kLanes];
  alignas(64) int lit[kLanes];
  sheet_.light(eye_, direction, hits, from_source, irradiance, lit);
  const bool any = std::any_of(lit, lit + kLanes, [](int lane) { return lane != 0; });
  if (any) shadow_view_.occlude(packet, from_source, kBeforeSurface, lit);
  const double ambient = plan_.settings.model.ambient_irradiance;
  if (!any && ambient == 0.0) return 0.0;
  double sum = 0.0;
  for (int l = 0; l < kLanes; ++l) {
    if (valid[l] == 0 || hits.shape[l] < 0) continue;
    const Surface& surface = surfaces_[static_cast<std::size_t>(hits.shape[l])];
    const double laser = lit[l] != 0 ? irradiance[l] : 0.0;
    sum += surface.reflection == nullptr ? surface.reflectance * (laser + ambient)
                                         : brightness(hits, l, direction, from_source, laser);
  }
  return sum;
}

double PixelTracer::trace(int column, int row) {
  const PixelRay ray = pixel_ray(column, row);
  const double values[6] = {ray.x, ray.y, ray.dx_du, ray.dx_dv, ray.dy_du, ray.dy_dv};
  const std::size_t samples = plan_.pattern.size();
  double sum = 0.0;
  for (std::size_t first = 0; first < samples; first += kLanes) {
    Lanes3 direction;
    spread_directions(axes_, values, &sample_column_[first], &sample_row_[first], direction);
    alignas(64) int valid[kLanes];
    for (std::size_t l = 0; l < kLanes; ++l) valid[l] = first + l < samples ? -1 : 0;
    sum += sum_packet(first / kLanes, direction, valid);
  }
  if (sum == 0.0) return 0.0;
  return electrons(column, row, sum / static_cast<double>(samples));
}

double PixelTracer::reflectance(int column, int row) {
  const PixelRay ray = pixel_ray(column, row);
  const double values[6] = {ray.x, ray.y, 0.0, 0.0, 0.0, 0.0};
  Lanes3 direction;
  spread_directions(axes_, values, sample_column_.data(), sample_row_.data(), direction);
  alignas(64) int valid[kLanes] = {};
  // The first packet holds instants from all over the exposure; one near its middle is as good as any.
  const auto middle = [&](std::size_t a, std::size_t b) {
    const auto distance = [&](std::size_t l) {
      const std::size_t twice = 2 * lane_instants_[l] + 1;
      return twice > plan_.pattern.size() ? twice - plan_.pattern.size() : plan_.pattern.size() - twice;
    };
    return distance(a) < distance(b);
  };
  std::size_t best = 0;
  for (std::size_t l = 1; l < std::min<std::size_t>(kLanes, plan_.pattern.size()); ++l)
    best = middle(l, best) ? l : best;
  const int chosen = static_cast<int>(best);
  valid[chosen] = -1;
  PacketHits hits;
  camera_views_[number_].intersect(0, direction, valid, kInfinity, hits);
  if (hits.shape[chosen] < 0) return 0.0;
  const Surface& surface = surfaces_[static_cast<std::size_t>(hits.shape[chosen])];
  if (surface.reflection == nullptr) return surface.reflectance;
  return surface.reflection->albedo(
      std::abs(lane(hits.normal, chosen).dot(lane(direction, chosen).normalized())));
}

double PixelTracer::electrons(int column, int row, double irradiance) const {
  const PixelRay ray = pixel_ray(column, row);
  const double cosine2 = 1.0 / (1.0 + ray.x * ray.x + ray.y * ray.y);
  return irradiance * cosine2 * cosine2 * plan_.electrons_per_irradiance[number_];
}

}  // namespace sensor_rt
