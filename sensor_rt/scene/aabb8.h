// Bounding boxes of the eight children of a tree node.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <limits>

namespace sensor_rt {

/// Eight axis-aligned boxes as a structure of arrays, [axis][box], in the frame of a shape.
struct alignas(64) Aabb8 {
  static constexpr int kCount = 8;

  float low[3][kCount];
  float high[3][kCount];

  /// Makes all boxes empty.
  void clear() {
    constexpr float kInfinity = std::numeric_limits<float>::infinity();
    std::fill(&low[0][0], &low[0][0] + 3 * kCount, kInfinity);
    std::fill(&high[0][0], &high[0][0] + 3 * kCount, -kInfinity);
  }

  void include(int slot, const Aabb8& from, int lane) {
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
