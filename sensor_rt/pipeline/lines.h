// The chain of stations that one thread runs exposures through.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sensor_rt/fan/fan_caster.h"
#include "sensor_rt/pipeline/sensor.h"
#include "sensor_rt/pipeline/stations.h"
#include "sensor_rt/render/image_renderer.h"

namespace sensor_rt {

struct ImageSize {
  int width = 0;
  int height = 0;
  std::size_t pixels() const { return static_cast<std::size_t>(width) * static_cast<std::size_t>(height); }
};

RenderSettings render_settings(const Sensor& sensor, bool whole_image, bool laser_on = true);

/// Light and detector.
class ImageLine {
 public:
  ImageLine(const RenderPlan& plan, const Detector& detector)
      : laser_on_(plan.settings.laser_on), renderer_(plan), detector_(detector) {}

  /// Light of one exposure on all cameras.
  void render(const Scene& scene, const Exposures& exposures, std::size_t exposure);

  /// The image that one camera makes of the light rendered last.
  void expose(const Exposures& exposures, std::size_t exposure, std::size_t camera,
              ImageView<std::uint16_t> out);

  StationSeconds& seconds() { return seconds_; }
  const StationSeconds& seconds() const { return seconds_; }

 private:
  bool laser_on_;
  ImageRenderer renderer_;
  const Detector& detector_;
  std::vector<SparseImage> light_;
  StationSeconds seconds_{};
};

/// From poses to points through images.
class RayTracedLine {
 public:
  /// `unlit` is the plan of the images with the laser off, null when there are none.
  RayTracedLine(const Sensor& sensor, const RenderPlan& plan, const RenderPlan* unlit,
                const Detector& detector);

  /// Where the images of all cameras of an exposure go, one after the other, unless null.
  struct Kept {
    std::uint16_t* lit = nullptr;
    std::uint16_t* unlit = nullptr;
  };

  /// Appends to `out`.
  void run(const Scene& scene, const Exposures& exposures, std::size_t exposure, const Kept& kept,
           Profiles& out);

  StationSeconds seconds() const;

 private:
  using Image = ImageView<const std::uint16_t>;

  /// Makes the image of a camera where it is kept, or in `scratch`.
  Image expose(ImageLine& line, const Exposures& exposures, std::size_t exposure, std::size_t camera,
               std::uint16_t* kept, std::vector<std::uint16_t>& scratch) const;

  const Sensor& sensor_;
  ImageLine images_;
  std::unique_ptr<ImageLine> unlit_;
  Extractor extractor_;
  std::vector<std::uint16_t> scratch_;
  std::vector<std::uint16_t> unlit_scratch_;
  Peaks peaks_;
};

/// From poses to points without images.
class GeometricLine {
 public:
  /// Where the sheet as built is the plane X = 0 and the cameras are those of `sensor`, landing points are
  /// taken as they are; else they are triangulated from the pixels that see them, as in images.
  GeometricLine(const Sensor& as_built, const Sensor& sensor);

  /// Fills `out`, which is empty.
  void run(const Scene& scene, const Exposures& exposures, std::size_t exposure, Profiles& out);

  StationSeconds& seconds() { return seconds_; }

 private:
  void read_by_belief(Profiles& profiles) const;

  const Sensor& as_built_;
  const Sensor& sensor_;
  bool exact_;
  FanCaster caster_;
  FanPoints points_;
  StationSeconds seconds_{};
};

}  // namespace sensor_rt
