// Ground truth: light followed from the pixels back to its sources.
#pragma once

#include <cstdint>

#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/lamps.h"
#include "sensor_rt/render/pixel_rays.h"
#include "sensor_rt/render/row_views.h"
#include "sensor_rt/render/speckle.h"

namespace sensor_rt {

/// Unbiased path tracing of single pixels, one path per sample of the pixel (Kajiya 1986). Every surface that
/// a path meets is connected to the laser's source and to a piece of every lamp, which no path meets by
/// chance. Ambient light is even light from all around the scene: paths that leave the scene bring it.
/// Sources seen by way of a mirror that the laser itself meets first are beyond such paths; LightTracer
/// follows those.
class PathTracer {
 public:
  enum class Mode {
    kAllBounces,      ///< up to settings.bounces reflections between surfaces
    kMirrorsOnly,     ///< reflections in mirrors only; ambient light falls evenly on what they show
    kReflectedLamps,  ///< nothing but light of lamps that was reflected between surfaces, seen straight
  };

  PathTracer(const RenderPlan& plan, Mode mode);

  /// `views` must stay, and `rows`, which is not null when every row has views of its own. `frame` keys the
  /// random numbers.
  void set(const ExposureViews& views, std::int64_t frame, RowViews* rows);
  void select_camera(std::size_t camera) {
    rays_.select_camera(camera);
    speckle_.select_camera(camera);
  }

  /// Expected electrons per second in a pixel.
  double trace(int column, int row);

 private:
  struct Packet;

  void use(const ExposureViews& views);
  void trace_packet(Packet& packet);
  double laser_light(Packet& packet, int depth);
  double lamp_light(const Packet& packet, int depth) const;
  void reflect(Packet& packet, int depth);
  double ambient_light(const Packet& packet, int depth) const;

  const RenderPlan& plan_;
  Mode mode_;
  PixelRays rays_;
  Speckle speckle_;
  Lamps lamps_;
  const ExposureViews* views_ = nullptr;
  RowViews* rows_ = nullptr;
  std::int64_t frame_ = 0;
};

}  // namespace sensor_rt
