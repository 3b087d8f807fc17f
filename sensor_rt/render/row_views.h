// The scene as every row of a rolling shutter sees it.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "sensor_rt/render/exposure_views.h"

namespace sensor_rt {

/// Rows are exposed one after the other, each as long as a global shutter's image, the middle row of a camera
/// in the middle of what the poses of the exposure cover: from the start of the first to the end of the last
/// row of the camera with the most rows. Views are made when a row is asked for, with the exact poses at each
/// sample's instant, and kept until the next exposure.
class RowViews {
 public:
  explicit RowViews(const RenderPlan& plan);

  /// Begins an exposure; scene and poses must stay.
  void set(const Scene& scene, const Exposures& exposures, std::size_t exposure);

  const ExposureViews& of_row(std::size_t camera, int row);

 private:
  struct Row {
    PoseTrack track;
    ExposureViews views;
    std::size_t made_for = 0;  ///< number of the exposure, counted from 1
  };

  const RenderPlan& plan_;
  const Scene* scene_ = nullptr;
  const Exposures* exposures_ = nullptr;
  std::size_t exposure_ = 0;
  std::size_t count_ = 0;  ///< exposures so far
  int tallest_ = 0;        ///< rows
  std::vector<double> fractions_;
  std::vector<std::unique_ptr<Row>> rows_;  ///< half a row apart: cameras may differ in height
};

}  // namespace sensor_rt
