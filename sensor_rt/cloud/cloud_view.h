// Non-owning view of a scanned point cloud.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>

namespace sensor_rt {

/// `count` points (count, 3) in the part frame, m, with their frame index, camera and image column, and the
/// light source position in each of `frames` frames (frames, 3), part frame, m.
struct CloudView {
  const double* points = nullptr;
  const std::int64_t* frame = nullptr;
  const std::int32_t* camera = nullptr;
  const std::int64_t* column = nullptr;
  std::size_t count = 0;
  const double* light = nullptr;
  std::size_t frames = 0;

  Eigen::Vector3d point(std::size_t i) const { return Eigen::Map<const Eigen::Vector3d>(points + 3 * i); }
  /// Returns the vector from a point to its light source.
  Eigen::Vector3d to_light(std::size_t i) const {
    return Eigen::Map<const Eigen::Vector3d>(light + 3 * frame[i]) - point(i);
  }
};

}  // namespace sensor_rt
