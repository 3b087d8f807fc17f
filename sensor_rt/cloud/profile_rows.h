// Points of a scan in grid order: camera, frame, column.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/cloud/cloud_view.h"
#include "sensor_rt/geometry/large_vector.h"

namespace sensor_rt {

/// One row per camera and frame; the points of a row in ascending columns, those of one column in the order
/// of the cloud.
class ProfileRows {
 public:
  /// Throws std::invalid_argument for a point that is not finite or too far away, or an invalid frame index.
  ProfileRows(const CloudView& cloud, unsigned threads);

  std::size_t cameras() const { return cameras_; }

  /// Returns the point indices of all rows, row by row.
  const LargeVector<std::uint32_t>& order() const { return order_; }

  /// Returns the first index of the row in order(); the next row begins at its end.
  std::size_t begin(std::size_t camera, std::size_t frame) const { return begin_[camera * frames_ + frame]; }
  std::size_t end(std::size_t camera, std::size_t frame) const {
    return begin_[camera * frames_ + frame + 1];
  }

 private:
  std::size_t frames_;
  std::size_t cameras_;
  std::vector<std::size_t> begin_;
  LargeVector<std::uint32_t> order_;
};

}  // namespace sensor_rt
