// Light of lamps that was reflected between surfaces.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/render/path_tracer.h"
#include "sensor_rt/render/pixel_tracer.h"

namespace sensor_rt {

/// Such light varies slowly over a surface: it is found by path tracing at the nodes of a grid, smoothed and
/// interpolated among those that show the same shape from a similar side. Mirrors show none of it.
class ReflectedLamps {
 public:
  explicit ReflectedLamps(const RenderPlan& plan);

  /// `views` must stay. `frame` keys the random numbers.
  void set(const ExposureViews& views, std::int64_t frame) { tracer_.set(views, frame, nullptr); }
  /// Traces the nodes of a camera, which `looks` must have selected.
  void select_camera(std::size_t camera, PixelTracer& looks);

  /// Electrons per second in a pixel that shows `seen`.
  double at(int column, int row, const LampView& seen);

 private:
  struct Node {
    LampView seen;
    double traced = 0.0;  ///< electrons per second
    double light = 0.0;   ///< the same, smoothed
  };

  double trace(int column, int row);
  double smoothed(int i, int j) const;

  const RenderPlan& plan_;
  PathTracer tracer_;
  const Camera* camera_ = nullptr;
  int columns_ = 0;
  int rows_ = 0;
  std::vector<Node> nodes_;
};

}  // namespace sensor_rt
