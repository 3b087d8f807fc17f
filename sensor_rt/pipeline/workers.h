// Workers: the pipeline stages that one thread runs per exposure to produce images and points.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sensor_rt/pipeline/sensor.h"
#include "sensor_rt/pipeline/stages.h"
#include "sensor_rt/render/image_renderer.h"

namespace sensor_rt {

struct ImageSize {
  int width = 0;
  int height = 0;
  std::size_t pixels() const { return static_cast<std::size_t>(width) * static_cast<std::size_t>(height); }
};

RenderSettings render_settings(const Sensor& sensor, bool laser_on = true);

/// Renders light and exposes the detector.
class ImageWorker {
 public:
  ImageWorker(const RenderPlan& plan, const Detector& detector) : plan_(plan), detector_(detector) {}

  /// Renders the light of one exposure for all cameras.
  void render(const Scene& scene, const Exposures& exposures, std::size_t exposure);

  /// Exposes the image of one camera with the last rendered light.
  void expose(const Exposures& exposures, std::size_t exposure, std::size_t camera,
              ImageView<std::uint16_t> out);

  StageSeconds& seconds() { return seconds_; }
  const StageSeconds& seconds() const { return seconds_; }

 private:
  const RenderPlan& plan_;
  const Detector& detector_;
  RenderBuffers buffers_;
  std::vector<SparseImage> light_;
  StageSeconds seconds_{};
};

/// Ray-traced engine: poses to points via images.
class RayTracedWorker {
 public:
  /// `background`: plan of the background frames (laser off); null: none. `keep_rejected`: see ScanOptions.
  RayTracedWorker(const Sensor& sensor, const RenderPlan& plan, const RenderPlan* background,
                  const Detector& detector, bool keep_rejected);

  /// Output buffers for the images of all cameras of an exposure; null: images are not kept.
  struct Kept {
    std::uint16_t* lit = nullptr;
    std::uint16_t* background = nullptr;
  };

  /// Appends the points of an exposure to `out`.
  void run(const Scene& scene, const Exposures& exposures, std::size_t exposure, const Kept& kept,
           Profiles& out);

  StageSeconds seconds() const;

 private:
  using Image = ImageView<const std::uint16_t>;

  /// Exposes the image of a camera into `kept` or, if null, `scratch`.
  Image expose(ImageWorker& worker, const Exposures& exposures, std::size_t exposure, std::size_t camera,
               std::uint16_t* kept, std::vector<std::uint16_t>& scratch) const;

  const Sensor& sensor_;
  TriangulationOptions triangulation_;
  ImageWorker images_;
  std::unique_ptr<ImageWorker> background_;
  Extractor extractor_;
  std::vector<std::uint16_t> scratch_;
  std::vector<std::uint16_t> background_scratch_;
  Peaks peaks_;
};

}  // namespace sensor_rt
