// Ground truth: path tracing from the pixels to the light sources.
#pragma once

#include <cstdint>

#include "sensor_rt/render/emitter/speckle.h"
#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/lamps/pixel_rays.h"
#include "sensor_rt/render/row_views.h"
#include "sensor_rt/tracing/lamps.h"

namespace sensor_rt {

/// Path tracing of single pixels, one path per sample of the pixel (Kajiya 1986), with next-event estimation;
/// unbiased for light of at most `bounces` reflections between surfaces, longer paths are left out: every hit
/// is connected to the laser source and to a sample of every lamp. Ambient light is uniform environment
/// light, collected by paths that leave the scene. Laser light that hits a mirror before the surface cannot
/// be sampled this way; LightTracer covers it. Laser light below translucent surfaces is found by random
/// walks in the body; after its first reflection all light leaves where it enters. Without state.
class PathTracer {
 public:
  enum class Mode {
    kAllBounces,      ///< up to settings.bounces reflections between surfaces
    kMirrorsOnly,     ///< specular reflections only; ambient light is uniform on the surfaces that they show
    kReflectedLamps,  ///< only lamp light reflected between surfaces, on directly visible points
  };

  /// Paths from the pixels of one camera. All must outlive it; `rows` is not null when every row has its own
  /// views. `frame` selects the random numbers.
  PathTracer(const RenderPlan& plan, Mode mode, const ExposureViews& views, RowViews* rows,
             std::size_t camera, std::int64_t frame);

  /// Returns the expected electrons per second in a pixel.
  double trace(int column, int row) const;

 private:
  struct Packet;

  void trace_packet(Packet& packet) const;
  double laser_light(const Packet& packet, int depth) const;
  double lamp_light(const Packet& packet, int depth) const;
  double light_below(const Packet& packet) const;
  /// Returns the sum of the light of all lanes, which leaves the surface that the camera sees, with speckle.
  double sum_with_grains(const Packet& packet, const double* light) const;
  void reflect(Packet& packet, int depth) const;
  double ambient_light(const Packet& packet, int depth) const;
  SurfacePoint surface(const Packet& packet, int l) const;

  const RenderPlan& plan_;
  Mode mode_;
  const ExposureViews& views_;
  RowViews* rows_;
  std::int64_t frame_;
  PixelRays rays_;
  Speckle speckle_;
};

}  // namespace sensor_rt
