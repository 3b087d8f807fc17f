// Views of the scene for each row of a rolling shutter.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "sensor_rt/render/exposure_views.h"

namespace sensor_rt {

/// Rows are exposed sequentially, each as long as a global-shutter image. The poses of the exposure cover the
/// time from the start of the first to the end of the last row of the tallest camera; the middle row of each
/// camera is exposed at the centre of that time. Views are computed on request, with the exact poses at the
/// instants of the samples, and cached until the next exposure.
class RowViews {
 public:
  explicit RowViews(const RenderPlan& plan);

  /// Begins an exposure; scene and poses must outlive its use.
  void set(const Scene& scene, const Exposures& exposures, std::size_t exposure);

  const ExposureViews& of_row(std::size_t camera, int row);

 private:
  struct Row {
    PoseTrack track;
    ExposureViews views;
    std::size_t made_for = 0;  ///< one-based index of the exposure
  };

  const RenderPlan& plan_;
  const Scene* scene_ = nullptr;
  const Exposures* exposures_ = nullptr;
  std::size_t exposure_ = 0;
  std::size_t count_ = 0;  ///< number of exposures so far
  int tallest_ = 0;        ///< rows
  std::vector<double> fractions_;
  std::vector<std::unique_ptr<Row>> rows_;  ///< spaced by half a row, as camera heights may differ
};

}  // namespace sensor_rt
