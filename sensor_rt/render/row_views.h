// Views of the scene for each row of a rolling shutter.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/row_timing.h"

namespace sensor_rt {

/// The poses of the exposure cover the time of all rows, see RowTiming. Views are computed on request, with
/// the exact poses at the instants of the samples; those of the last rows are kept, as many as samples
/// permit, so that rows are best visited in ascending order.
class RowViews {
 public:
  /// Views of a row. Their memory is reused from exposure to exposure.
  struct Row {
    PoseTrack track;
    ExposureViews views;
    int half_rows = kNone;
  };
  static constexpr int kNone = -1;
  using Rows = std::vector<std::unique_ptr<Row>>;

  /// Scene, poses and `rows` must outlive it.
  RowViews(const RenderPlan& plan, const Scene& scene, const Exposures& exposures, std::size_t exposure,
           Rows& rows);

  const ExposureViews& of_row(std::size_t camera, int row);

 private:
  const RenderPlan& plan_;
  const Scene& scene_;
  const Exposures& exposures_;
  std::size_t exposure_;
  RowTiming timing_;
  Rows& rows_;  ///< by half rows, as camera heights may differ, modulo their number
};

}  // namespace sensor_rt
