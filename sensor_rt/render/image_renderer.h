// Light over moving poses -> expected electrons per pixel.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/render/ambient.h"
#include "sensor_rt/render/band_marker.h"
#include "sensor_rt/render/pixel_mask.h"
#include "sensor_rt/render/pixel_tracer.h"

namespace sensor_rt {

/// Pixels that collect light, each once; pixel = row * width + column.
struct SparseImage {
  std::vector<std::uint32_t> pixels;
  std::vector<float> electrons;
};

/// Renders exposures one by one. Keeps scratch memory: one per thread. The plan must outlive it.
class ImageRenderer {
 public:
  explicit ImageRenderer(const RenderPlan& plan);

  /// One image per camera. Depends on the exposure's poses alone; a still exposure gives the same bytes
  /// however often its poses were sampled.
  void render(const Scene& scene, const Exposures& exposures, std::size_t exposure,
              std::vector<SparseImage>& images);

 private:
  void find_pixels(const Scene& scene);
  void trace_camera(std::size_t camera, double duration, SparseImage& image);

  const RenderPlan& plan_;
  std::vector<double> fractions_;
  std::vector<double> middle_;
  PoseTrack track_;
  BandMarker marker_;
  PixelTracer tracer_;
  AmbientFiller ambient_;
  std::vector<PixelMask> masks_;
};

}  // namespace sensor_rt
