#include "sensor_rt/render/render_plan.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor_rt/optics/region.h"

namespace sensor_rt {
namespace {

/// Returns the depths that any camera sees, m from the source.
DepthRange depths_from_source(const SensorModel& model) {
  DepthRange all{std::numeric_limits<double>::infinity(), 0.0};
  for (const Camera& camera : model.cameras) {
    const DepthRange depth = visible_depth(camera);
    all.near = std::min(all.near, depth.near);
    all.far = std::max(all.far, depth.far);
  }
  constexpr double kNearest = 1e-3;
  const double source = model.laser.source_z;
  all.near = std::max(all.near - source, kNearest);
  all.far = std::max(all.near, std::min(all.far, kFarthest) - source);
  return all;
}

/// Returns the largest half width of the sheet relative to the distance from the source.
double largest_slope(const LaserSheet& laser, const DepthRange& depths) {
  double slope = 0.0;
  constexpr int kSteps = 256;
  for (int i = 0; i <= kSteps; ++i) {
    const double depth = depths.near + (depths.far - depths.near) * i / kSteps;
    slope = std::max(slope, kSheetReach * laser.sigma_at(laser.source_z + depth) / depth);
  }
  return slope * 1.02;  // margin: the depths are sampled
}

/// Returns the settings with camera poses in the frame of the sheet and the power that the laser has.
RenderSettings in_frame_of_sheet(RenderSettings settings) {
  const Rigid3 sheet_from_sensor = settings.model.laser.sensor_from_sheet.inverse();
  for (Camera& camera : settings.model.cameras) {
    camera.sensor_from_camera = sheet_from_sensor * camera.sensor_from_camera;
  }
  if (!settings.laser_on) settings.model.laser.power = 0.0;
  return settings;
}

std::vector<Eigen::Vector3d> spread_sources(const LaserSheet& laser, const SamplingPattern& pattern) {
  const Eigen::Vector3d middle(0.0, 0.0, laser.source_z);
  if (laser.source_length == 0.0) return {middle};
  std::vector<Eigen::Vector3d> sources;
  for (std::size_t i = 0; i < pattern.padded_size(); ++i) {
    const double position = pattern.source[pattern.sample_of(i)];
    sources.push_back(middle + Eigen::Vector3d(0.0, laser.source_length * position, 0.0));
  }
  return sources;
}

std::vector<Eigen::Vector3d> spread_viewpoints(const Camera& camera, const SamplingPattern& pattern) {
  if (!camera.has_depth_of_field()) return {camera.sensor_from_camera.translation};
  std::vector<Eigen::Vector3d> viewpoints;
  for (std::size_t i = 0; i < pattern.padded_size(); ++i) {
    const std::size_t sample = pattern.sample_of(i);
    viewpoints.push_back(camera.sensor_from_camera *
                         Eigen::Vector3d(pattern.lens_x[sample] * camera.aperture_radius(),
                                         pattern.lens_y[sample] * camera.aperture_radius(), 0.0));
  }
  return viewpoints;
}

CameraSamples spread_samples(const Camera& camera, const SamplingPattern& pattern) {
  CameraSamples samples;
  for (std::size_t i = 0; i < pattern.padded_size(); ++i) {
    const std::size_t sample = pattern.sample_of(i);
    samples.column.push_back(blurred_pixel_quantile(pattern.column[sample] + 0.5, camera.psf_sigma_px));
    samples.row.push_back(blurred_pixel_quantile(pattern.row[sample] + 0.5, camera.psf_sigma_px));
    samples.lens_x.push_back(pattern.lens_x[sample] * camera.aperture_radius());
    samples.lens_y.push_back(pattern.lens_y[sample] * camera.aperture_radius());
  }
  return samples;
}

/// Returns points of single lanes in packets.
template <typename Point>
std::vector<Lanes3> in_packets(std::size_t lanes, const Point& point) {
  std::vector<Lanes3> packets(lanes / kLanes);
  for (std::size_t packet = 0; packet < packets.size(); ++packet) {
    for (int l = 0; l < kLanes; ++l) set_lane(packets[packet], l, point(packet, l));
  }
  return packets;
}

StripeCamera stripe_camera(const Camera& camera, double beyond) {
  std::optional<LensBlur> blur;
  if (LensBlur::is_needed(camera) && LensBlur::is_accurate(camera)) blur.emplace(camera);
  const Camera optics = blur ? blur->sharp_camera() : camera;
  return {optics, Projector(optics), optics.sensor_from_camera.inverse(), camera_region(optics, beyond),
          blur};
}

LensPoint lens_point(const Camera& camera, const SamplingPattern& pattern, std::size_t sample) {
  LensPoint point;
  point.is_centre = !LensBlur::is_needed(camera);
  if (camera.has_depth_of_field()) {
    point.in_camera =
        camera.aperture_radius() * Eigen::Vector2d(pattern.lens_x[sample], pattern.lens_y[sample]);
  }
  point.blur_px = camera.psf_sigma_px * Eigen::Vector2d(normal_quantile(pattern.column[sample] + 0.5),
                                                        normal_quantile(pattern.row[sample] + 0.5));
  point.viewpoint =
      camera.sensor_from_camera * Eigen::Vector3d(point.in_camera.x(), point.in_camera.y(), 0.0);
  return point;
}

}  // namespace

RenderPlan::RenderPlan(const RenderSettings& given)
    : settings(in_frame_of_sheet(given)),
      laser(settings.model.laser),
      pattern(make_sampling_pattern(static_cast<std::size_t>(given.samples_per_pixel))),
      sensor_from_reference(given.model.laser.sensor_from_sheet),
      lane_sources(spread_sources(given.model.laser, pattern)) {
  const SensorModel& model = settings.model;
  if (settings.speckle_contrast > 0.0) {
    speckle_tile = SpeckleTile::shared(settings.speckle_contrast);
    for (const Camera& camera : model.cameras) {
      const double pixel = SpeckleTile::kPerGrain / camera.grain_px(model.laser.wavelength);
      pixel_speckle.push_back(SpeckleTile::shared(settings.speckle_contrast, pixel));
    }
  }
  sources =
      in_packets(pattern.padded_size(), [this](std::size_t packet, int l) { return source(packet, l); });
  const DepthRange depths = depths_from_source(model);
  nearest = depths.near;
  slope = largest_slope(model.laser, depths);
  laser_region = sensor_rt::laser_region(model.laser, slope / std::cos(model.laser.fan_half_angle));
  double beyond = 0.0;
  pixel_size = std::numeric_limits<double>::infinity();
  for (const Camera& camera : model.cameras) {
    const DepthRange depth = visible_depth(camera);
    const double far = std::min(depth.far, kFarthest);
    const Eigen::Vector3d nearest(0.0, 0.0, depth.near);
    pixel_size =
        std::min(pixel_size, (nearest - camera.sensor_from_camera.translation).norm() / camera.focal_px);
    const double bend = model.laser.max_bend() * (far - model.laser.source_z);
    beyond = std::max({beyond, kSheetReach * model.laser.sigma_at(depth.near) + bend,
                       kSheetReach * model.laser.sigma_at(far) + bend});
  }
  for (const Camera& camera : model.cameras) {
    lane_viewpoints.push_back(spread_viewpoints(camera, pattern));
    samples.push_back(spread_samples(camera, pattern));
    samples.back().viewpoints = in_packets(pattern.padded_size(), [&](std::size_t packet, int l) {
      return viewpoint(samples.size() - 1, packet, l);
    });
    projectors.emplace_back(camera);
    stripe_cameras.push_back(stripe_camera(camera, 1.1 * beyond));
    camera_fields.push_back(camera_field(camera));
    electrons_per_irradiance.push_back(
        sensor_rt::electrons_per_irradiance(camera, model.laser.wavelength, settings.quantum_efficiency));
  }
  const bool is_sampled =
      model.laser.source_length > 0.0 ||
      std::any_of(stripe_cameras.begin(), stripe_cameras.end(),
                  [](const StripeCamera& camera) { return LensBlur::is_needed(camera.optics); });
  for (std::size_t sample = 0; sample < (is_sampled ? pattern.size() : 1); ++sample) {
    LatticePoint point;
    point.source = source(sample / kLanes, static_cast<int>(sample % kLanes));
    for (const StripeCamera& camera : stripe_cameras)
      point.lenses.push_back(lens_point(camera.optics, pattern, sample));
    stripe_lattice.push_back(point);
  }
}

}  // namespace sensor_rt
