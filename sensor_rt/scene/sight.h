// What an eye sees of boxes, as rectangles in its picture.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <limits>

#include "sensor_rt/geometry/rigid3.h"

namespace sensor_rt {

/// Rectangle in the picture of an eye that looks along an axis X: Y and Z over depth.
struct Window {
  static constexpr float kInfinity = std::numeric_limits<float>::infinity();

  float low[2] = {kInfinity, kInfinity};
  float high[2] = {-kInfinity, -kInfinity};
  float depth = 0.0f;  ///< of the farthest thing in it, m

  static Window everything() { return {{-kInfinity, -kInfinity}, {kInfinity, kInfinity}, kInfinity}; }
  bool empty() const { return !(low[0] <= high[0]); }
  void include(const Window& other) {
    for (int k = 0; k < 2; ++k) {
      low[k] = std::min(low[k], other.low[k]);
      high[k] = std::max(high[k], other.high[k]);
    }
    depth = std::max(depth, other.depth);
  }
};

/// Eight boxes as a structure of arrays: along x, y and z of a shape.
struct alignas(32) EightBoxes {
  static constexpr int kCount = 8;
  float low[3][kCount];
  float high[3][kCount];
};

/// A few windows.
class Windows {
 public:
  static constexpr int kMost = 64;

  int count() const { return count_; }
  /// Holds all of them.
  const Window& frame() const { return frame_; }
  void clear();
  void add(const Window& window);
  /// True when one of them and `window` overlap.
  bool meet(const Window& window) const;

 private:
  int count_ = 0;
  Window frame_;
  alignas(64) float low_[2][kMost];
  alignas(64) float high_[2][kMost];
};

/// Bundles of lines of sight, each with its window and no longer than the deepest of them, in the frame of a
/// shape. The eye looks along -X of the reference frame for `side` +1, along +X for -1.
class Sight {
 public:
  Sight(const Rigid3& shape_from_reference, const Eigen::Vector3d& eye_in_reference, int side,
        const Windows& bundles);

  const float* eye_in_shape() const { return eye_; }

  /// Windows in which the boxes of `those` (bits) are seen, and which of these may stand in a line of sight.
  unsigned see(const EightBoxes& boxes, unsigned those, Window* windows) const;

 private:
  float eye_[3];
  float axes_[3][3];  ///< of depth, Y and Z
  float slack_;       ///< room for rounding, m
  const Windows& bundles_;
};

}  // namespace sensor_rt
