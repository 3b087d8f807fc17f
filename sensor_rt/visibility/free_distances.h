// Free distance from a surface sample in each direction of a grid.
#pragma once

#include <Eigen/Dense>
#include <cstdint>
#include <vector>

#include "sensor_rt/scene/embree.h"
#include "sensor_rt/visibility/direction_grid.h"

namespace sensor_rt {

/// Free distances of one sample at a time. Rays are cast lazily in packets of a tile.
class FreeDistances {
 public:
  /// `farthest`: maximum ray length, m.
  FreeDistances(RTCScene scene, const DirectionGrid& grid, double farthest);

  /// Starts a sample: `origin` in the frame of the Embree scene, slightly off the surface. Directions whose
  /// cosine with the normal is below `min_cosine` are treated as blocked.
  void start(const Eigen::Vector3f& origin, const Eigen::Vector3f& normal, float min_cosine);

  /// Returns the distance (m) to the closest surface in the direction of a cell, `farthest` without a hit.
  float distance(int cell) {
    const auto tile = static_cast<std::size_t>(cell / DirectionGrid::kTileCells);
    if (!is_cast_[tile]) cast(tile);
    return distance_[static_cast<std::size_t>(cell)];
  }

 private:
  void cast(std::size_t tile);

  RTCScene scene_;
  float farthest_;
  std::vector<float> direction_[3];  ///< of the centre of each cell
  std::vector<float> distance_;      ///< of each cell
  std::vector<std::uint8_t> is_cast_;
  Eigen::Vector3f origin_ = Eigen::Vector3f::Zero();
  Eigen::Vector3f normal_ = Eigen::Vector3f::Zero();
  float min_cosine_ = 0.0f;
};

}  // namespace sensor_rt
