#include "sensor_rt/pipeline/lines.h"

#include <cmath>

namespace sensor_rt {

RenderSettings render_settings(const Sensor& sensor, bool whole_image) {
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
  const FrameId id{exposures.index[exposure], static_cast<int>(camera), exposures.duration[exposure]};
  const SparseImage& image = light_[camera];
  detector_.expose(id, image.pixels.data(), image.electrons.data(), image.pixels.size(), out);
}

RayTracedLine::RayTracedLine(const Sensor& sensor, const RenderPlan& plan, const Detector& detector)
    : sensor_(sensor), images_(plan, detector), extractor_(make_extractor(sensor, false)) {}

void RayTracedLine::run(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                        std::uint16_t* kept, Profiles& out) {
  images_.render(scene, exposures, exposure);
  peaks_.clear();
  for (std::size_t c = 0; c < sensor_.cameras.size(); ++c) {
    const ImageSize size{sensor_.cameras[c].width_px, sensor_.cameras[c].height_px};
    if (kept == nullptr) scratch_.resize(size.pixels());
    std::uint16_t* pixels = kept == nullptr ? scratch_.data() : kept + c * size.pixels();
    images_.expose(exposures, exposure, c, {pixels, size.width, size.height, size.width});
    const Stopwatch watch(images_.seconds()[kExtract]);
    extractor_.measure({pixels, size.width, size.height, size.width}, static_cast<int>(c));
  }
  {
    const Stopwatch watch(images_.seconds()[kExtract]);
    extractor_.finish(exposures.index[exposure], peaks_);
  }
  const Stopwatch watch(images_.seconds()[kTriangulate]);
  triangulate(peaks_, sensor_.cameras, sensor_.triangulation, out);
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
