// Rendering: poses and light -> expected electrons per pixel.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/render/ambient.h"
#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/filled_pixels.h"
#include "sensor_rt/render/lamp_filler.h"
#include "sensor_rt/render/light_tracer.h"
#include "sensor_rt/render/lit_pixel_marker.h"
#include "sensor_rt/render/path_tracer.h"
#include "sensor_rt/render/pixel_cover.h"
#include "sensor_rt/render/pixel_mask.h"
#include "sensor_rt/render/pixel_tracer.h"
#include "sensor_rt/render/reflected_lamps.h"
#include "sensor_rt/render/row_views.h"

namespace sensor_rt {

/// Pixels that receive light, each once; index = row * width + column.
struct SparseImage {
  std::vector<std::uint32_t> pixels;
  std::vector<float> electrons;
};

/// Renders exposures one by one. Keeps scratch memory: use one per thread. The plan must outlive it.
class ImageRenderer {
 public:
  explicit ImageRenderer(const RenderPlan& plan);

  /// Renders one image per camera. Direct light depends on the poses of the exposure alone; an exposure
  /// without motion gives the same bytes for any number of pose samples. Reflected light is computed from
  /// random paths that depend on the seed and the frame number. With a rolling shutter the poses cover the
  /// time of all rows, see RowViews, and there is no reflected light.
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

  /// Whether laser light reflected between surfaces is traced.
  bool follows_photons() const {
    return plan_.settings.laser_on && !reflected_.empty() && (has_mirrors_ || !plan_.settings.ground_truth);
  }

  const RenderPlan& plan_;
  double start_;  ///< start of the exposure in units of the duration of the poses: 1 for an image that
                  ///< follows another one
  std::vector<double> fractions_;
  std::vector<double> middle_;
  PoseTrack track_;
  ExposureViews views_;
  RowViews rows_;
  LitPixelMarker marker_;
  PixelCover cover_;
  FilledPixels filled_;
  PixelTracer tracer_;
  AmbientFiller ambient_;
  LampFiller lamps_;
  ReflectedLamps reflected_lamps_;
  PathTracer path_tracer_;
  PathTracer mirror_tracer_;
  LightTracer light_tracer_;
  bool is_rolling_ = false;  ///< rows are exposed at different times
  bool has_mirrors_ = false;
  PixelMask mirror_mask_;
  std::vector<SplatImage> reflected_;  ///< per camera, when there are bounces
  std::vector<float> dense_;
  std::vector<PixelMask> masks_;
};

}  // namespace sensor_rt
