#include "sensor_rt/pipeline/lines.h"

#include <cmath>

namespace sensor_rt {

RenderSettings render_settings(const Sensor& sensor, bool whole_image, bool laser_on) {
  RenderSettings settings;
  settings.model = sensor;
  settings.quantum_efficiency = sensor.detector.quantum_efficiency;
  settings.samples_per_pixel = sensor.samples_per_pixel;
  settings.rays_across_fan = sensor.rays_across_fan;
  settings.whole_image = whole_image;
  settings.ground_truth = sensor.ground_truth;
  settings.bounces = sensor.bounces;
  settings.photons = sensor.photons;
  settings.seed = sensor.seed;
  settings.speckle_contrast = sensor.speckle_contrast;
  settings.laser_on = laser_on;
  settings.row_readout = sensor.row_readout;
  return settings;
}

void ImageLine::render(const Scene& scene, const Exposures& exposures, std::size_t exposure) {
  const Stopwatch watch(seconds_[kRender]);
  renderer_.render(scene, exposures, exposure, light_);
}

void ImageLine::expose(const Exposures& exposures, std::size_t exposure, std::size_t camera,
                       ImageView<std::uint16_t> out) {
  const Stopwatch watch(seconds_[kDetect]);
  const FrameId id{frame_number(exposures, exposure, laser_on_), static_cast<int>(camera),
                   exposures.duration[exposure]};
  const SparseImage& image = light_[camera];
  detector_.expose(id, image.pixels.data(), image.electrons.data(), image.pixels.size(), out);
}

RayTracedLine::RayTracedLine(const Sensor& sensor, const RenderPlan& plan, const RenderPlan* unlit,
                             const Detector& detector)
    : sensor_(sensor),
      images_(plan, detector),
      unlit_(unlit == nullptr ? nullptr : std::make_unique<ImageLine>(*unlit, detector)),
      extractor_(make_extractor(sensor, false)) {}

RayTracedLine::Image RayTracedLine::expose(ImageLine& line, const Exposures& exposures, std::size_t exposure,
                                           std::size_t camera, std::uint16_t* kept,
                                           std::vector<std::uint16_t>& scratch) const {
  const ImageSize size{sensor_.cameras[camera].width_px, sensor_.cameras[camera].height_px};
  if (kept == nullptr) scratch.resize(size.pixels());
  std::uint16_t* pixels = kept == nullptr ? scratch.data() : kept + camera * size.pixels();
  line.expose(exposures, exposure, camera, {pixels, size.width, size.height, size.width});
  return {pixels, size.width, size.height, size.width};
}

void RayTracedLine::run(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                        const Kept& kept, Profiles& out) {
  images_.render(scene, exposures, exposure);
  if (unlit_) unlit_->render(scene, exposures, exposure);
  peaks_.clear();
  for (std::size_t c = 0; c < sensor_.cameras.size(); ++c) {
    const auto camera = static_cast<int>(c);
    const Image image = expose(images_, exposures, exposure, c, kept.lit, scratch_);
    if (unlit_) {
      const Image unlit = expose(*unlit_, exposures, exposure, c, kept.unlit, unlit_scratch_);
      const Stopwatch watch(images_.seconds()[kExtract]);
      extractor_.measure(image, unlit, camera);
    } else {
      const Stopwatch watch(images_.seconds()[kExtract]);
      extractor_.measure(image, camera);
    }
  }
  {
    const Stopwatch watch(images_.seconds()[kExtract]);
    extractor_.finish(exposures.index[exposure], peaks_);
  }
  const Stopwatch watch(images_.seconds()[kTriangulate]);
  triangulate(peaks_, sensor_.cameras, sensor_.triangulation, out);
}

StationSeconds RayTracedLine::seconds() const {
  StationSeconds sum = images_.seconds();
  for (std::size_t s = 0; unlit_ && s < sum.size(); ++s) sum[s] += unlit_->seconds()[s];
  return sum;
}

GeometricLine::GeometricLine(const Sensor& as_built, const Sensor& sensor)
    : as_built_(as_built),
      sensor_(sensor),
      exact_(&as_built == &sensor && as_built.laser.is_nominal()),
      caster_({as_built.cameras, as_built.laser, sensor.near, sensor.far, sensor.geometric_rays}) {}

void GeometricLine::run(const Scene& scene, const Exposures& exposures, std::size_t exposure, Profiles& out) {
  const Stopwatch watch(seconds_[kCast]);
  caster_.cast(scene, exposures, exposure, points_);
  const std::size_t count = points_.size();
  // These points are exact: no uncertainty, no flags.
  out.frame.assign(count, exposures.index[exposure]);
  out.sigma.assign(count, 0.0f);
  out.flags.assign(count, 0);
  out.camera.swap(points_.camera);
  out.column.swap(points_.column);
  out.row.swap(points_.row);
  out.points_in_sensor.swap(points_.point);
  out.intensity.swap(points_.brightness);
  if (!exact_) read_by_belief(out);
}

void GeometricLine::read_by_belief(Profiles& profiles) const {
  std::vector<Rigid3> camera_from_sensor;
  for (const Camera& camera : as_built_.cameras) {
    camera_from_sensor.push_back(camera.sensor_from_camera.inverse());
  }
  for (std::size_t i = 0; i < profiles.size(); ++i) {
    const auto c = static_cast<std::size_t>(profiles.camera[i]);
    const Eigen::Vector2d pixel =
        as_built_.cameras[c].project(camera_from_sensor[c] * profiles.points_in_sensor[i]);
    profiles.points_in_sensor[i] = triangulate_exact(sensor_.cameras[c], pixel);
  }
}

}  // namespace sensor_rt
