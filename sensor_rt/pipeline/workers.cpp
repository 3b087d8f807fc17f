#include "sensor_rt/pipeline/workers.h"

namespace sensor_rt {

RenderSettings render_settings(const Sensor& sensor, bool laser_on) {
  RenderSettings settings;
  static_cast<RenderOptions&>(settings) = sensor;
  settings.model = sensor;
  settings.quantum_efficiency = sensor.detector.quantum_efficiency;
  settings.laser_on = laser_on;
  return settings;
}

void ImageWorker::render(const Scene& scene, const Exposures& exposures, std::size_t exposure) {
  const Stopwatch watch(seconds_[kRender]);
  render_light(plan_, scene, exposures, exposure, buffers_, light_);
}

void ImageWorker::expose(const Exposures& exposures, std::size_t exposure, std::size_t camera,
                         ImageView<std::uint16_t> out) {
  const Stopwatch watch(seconds_[kDetect]);
  const FrameId id{frame_number(exposures, exposure, plan_.settings.laser_on), static_cast<int>(camera),
                   exposures.duration[exposure]};
  const SparseImage& image = light_[camera];
  detector_.expose(id, image.pixels.data(), image.electrons.data(), image.pixels.size(), out);
}

RayTracedWorker::RayTracedWorker(const Sensor& sensor, const RenderPlan& plan, const RenderPlan* background,
                                 const Detector& detector, bool keep_rejected)
    : sensor_(sensor),
      triangulation_(sensor.triangulation),
      images_(plan, detector),
      background_(background == nullptr ? nullptr : std::make_unique<ImageWorker>(*background, detector)),
      extractor_(make_extractor(sensor, false)) {
  triangulation_.keep_rejected = keep_rejected;
}

RayTracedWorker::Image RayTracedWorker::expose(ImageWorker& worker, const Exposures& exposures,
                                               std::size_t exposure, std::size_t camera, std::uint16_t* kept,
                                               std::vector<std::uint16_t>& scratch) const {
  const ImageSize size{sensor_.cameras[camera].width_px, sensor_.cameras[camera].height_px};
  if (kept == nullptr) scratch.resize(size.pixels());
  std::uint16_t* pixels = kept == nullptr ? scratch.data() : kept + camera * size.pixels();
  worker.expose(exposures, exposure, camera, {pixels, size.width, size.height, size.width});
  return {pixels, size.width, size.height, size.width};
}

void RayTracedWorker::run(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                          const Kept& kept, Profiles& out) {
  images_.render(scene, exposures, exposure);
  if (background_) background_->render(scene, exposures, exposure);
  peaks_.clear();
  for (std::size_t c = 0; c < sensor_.cameras.size(); ++c) {
    const auto camera = static_cast<int>(c);
    const Image image = expose(images_, exposures, exposure, c, kept.lit, scratch_);
    if (background_) {
      const Image background =
          expose(*background_, exposures, exposure, c, kept.background, background_scratch_);
      const Stopwatch watch(images_.seconds()[kExtract]);
      extractor_.measure(image, background, camera);
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
  triangulate(peaks_, sensor_.cameras, triangulation_, out);
}

StageSeconds RayTracedWorker::seconds() const {
  StageSeconds sum = images_.seconds();
  for (std::size_t s = 0; background_ && s < sum.size(); ++s) sum[s] += background_->seconds()[s];
  return sum;
}

}  // namespace sensor_rt
