// Bounds of the eight nodes below a node of a tree.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <limits>

namespace sensor_rt {

/// Eight boxes as a structure of arrays: along x, y and z of a shape.
struct alignas(64) EightBoxes {
  static constexpr int kCount = 8;

  float low[3][kCount];
  float high[3][kCount];

  /// Leaves boxes that hold nothing.
  void clear() {
    constexpr float kInfinity = std::numeric_limits<float>::infinity();
    std::fill(&low[0][0], &low[0][0] + 3 * kCount, kInfinity);
    std::fill(&high[0][0], &high[0][0] + 3 * kCount, -kInfinity);
  }

  void include(int slot, const EightBoxes& from, int lane) {
    for (int k = 0; k < 3; ++k) {
      low[k][slot] = std::min(low[k][slot], from.low[k][lane]);
      high[k][slot] = std::max(high[k][slot], from.high[k][lane]);
    }
  }

  void include(int slot, const Eigen::Vector3d& point) {
    for (int k = 0; k < 3; ++k) {
      low[k][slot] = std::min(low[k][slot], static_cast<float>(point[k]));
      high[k][slot] = std::max(high[k][slot], static_cast<float>(point[k]));
    }
  }
};

}  // namespace sensor_rt
