// Lamp light reflected between surfaces.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/render/path_tracer.h"
#include "sensor_rt/render/pixel_tracer.h"

namespace sensor_rt {

/// This light varies slowly over a surface: it is path traced at the nodes of a grid, smoothed, and
/// interpolated among nodes on the same shape with similar normals. Mirrors receive none.
class ReflectedLamps {
 public:
  explicit ReflectedLamps(const RenderPlan& plan);

  /// `views` must outlive its use. `frame` selects the random numbers.
  void set(const ExposureViews& views, std::int64_t frame) { tracer_.set(views, frame, nullptr); }
  /// Traces the nodes of a camera, which must be selected in `looks`.
  void select_camera(std::size_t camera, PixelTracer& looks);

  /// Returns the electrons per second in a pixel that shows `seen`.
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
