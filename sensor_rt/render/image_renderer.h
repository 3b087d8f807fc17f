// Light over moving poses -> expected electrons per pixel.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/render/ambient.h"
#include "sensor_rt/render/band_marker.h"
#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/lamp_filler.h"
#include "sensor_rt/render/light_tracer.h"
#include "sensor_rt/render/path_tracer.h"
#include "sensor_rt/render/pixel_cover.h"
#include "sensor_rt/render/pixel_mask.h"
#include "sensor_rt/render/pixel_tracer.h"
#include "sensor_rt/render/reflected_lamps.h"
#include "sensor_rt/render/row_views.h"

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

  /// One image per camera. Direct light depends on the exposure's poses alone, and a still exposure gives the
  /// same bytes however often its poses were sampled. Reflected light is found by random paths, keyed by seed
  /// and number of the exposure. With a rolling shutter the poses cover the time of all rows, see RowViews,
  /// and there is no reflected light.
  void render(const Scene& scene, const Exposures& exposures, std::size_t exposure,
              std::vector<SparseImage>& images);

 private:
  bool place(const Scene& scene, const Exposures& exposures, std::size_t exposure);
  void find_pixels(const Scene& scene);
  void trace_camera(std::size_t camera, double duration, SparseImage& image);
  void trace_marked(std::size_t camera, double duration, SparseImage& image);
  void mark_mirrors(std::size_t camera);
  void add_reflected(std::size_t camera, double duration, SparseImage& image);
  void add_lamps(std::size_t camera, double duration, SparseImage& image);
  void add_dense(SparseImage& image);

  /// Of the laser, from surface to surface.
  bool follows_photons() const {
    return plan_.settings.laser_on && !reflected_.empty() && (has_mirrors_ || !plan_.settings.ground_truth);
  }

  const RenderPlan& plan_;
  double start_;  ///< in units of what the poses cover: 1 for an image that follows another one
  std::vector<double> fractions_;
  std::vector<double> middle_;
  PoseTrack track_;
  ExposureViews views_;
  RowViews rows_;
  BandMarker marker_;
  PixelCover cover_;
  PixelTracer tracer_;
  AmbientFiller ambient_;
  LampFiller lamps_;
  ReflectedLamps reflected_lamps_;
  PathTracer path_tracer_;
  PathTracer mirror_tracer_;
  LightTracer light_tracer_;
  bool is_rolling_ = false;  ///< rows see different times of the exposure
  bool has_mirrors_ = false;
  PixelMask mirror_mask_;
  std::vector<SplatImage> reflected_;  ///< per camera, when there are bounces
  std::vector<float> dense_;
  std::vector<PixelMask> masks_;
};

}  // namespace sensor_rt
