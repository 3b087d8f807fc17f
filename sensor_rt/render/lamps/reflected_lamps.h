// Lamp light reflected between surfaces.
#pragma once

#include <cstdint>

#include "sensor_rt/render/lamps/block_grid.h"
#include "sensor_rt/render/lamps/centre_tracer.h"
#include "sensor_rt/render/paths/path_tracer.h"

namespace sensor_rt {

/// This light varies slowly over a surface: it is path traced at the nodes of a grid, smoothed, and
/// interpolated among nodes on the same shape with similar normals. Mirrors receive none.
class ReflectedLamps {
 public:
  /// Traces the nodes of a camera; `direct`: of the same camera. All must outlive it. `frame` selects the
  /// random numbers.
  ReflectedLamps(const RenderPlan& plan, const ExposureViews& views, std::size_t camera, std::int64_t frame,
                 const CentreTracer& direct);

  /// Returns the electrons per second in a pixel that shows `seen`.
  double at(int column, int row, const LampView& seen) const;

 private:
  struct Node {
    LampView seen;
    double traced = 0.0;  ///< electrons per second
    double light = 0.0;   ///< the same, smoothed
  };

  double trace(int column, int row) const;
  double smoothed(int i, int j) const;

  const Camera& camera_;
  int samples_;  ///< of a pixel
  PathTracer tracer_;
  BlockGrid<Node> nodes_;
};

}  // namespace sensor_rt
