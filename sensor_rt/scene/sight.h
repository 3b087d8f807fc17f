// What an eye sees of boxes, as rectangles in its picture.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <limits>

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/scene/eight_boxes.h"

namespace sensor_rt {

/// Which axis of a reference frame an eye looks along: that is depth. The picture has the axis Y across and,
/// along it, Z or X, whichever is left.
enum class ViewAxes { kX, kBackX, kZ };

/// Rectangle in the picture of an eye, and a range of depth: across and along, both over depth, and depth
/// (m).
struct Window {
  static constexpr float kInfinity = std::numeric_limits<float>::infinity();
  static constexpr int kAxes = 3;

  float low[kAxes] = {kInfinity, kInfinity, kInfinity};
  float high[kAxes] = {-kInfinity, -kInfinity, -kInfinity};

  static Window everything() {
    return {{-kInfinity, -kInfinity, -kInfinity}, {kInfinity, kInfinity, kInfinity}};
  }
  bool empty() const { return !(low[0] <= high[0]); }
  void include(const Window& other) {
    for (int k = 0; k < kAxes; ++k) {
      low[k] = std::min(low[k], other.low[k]);
      high[k] = std::max(high[k], other.high[k]);
    }
  }
  bool holds(const Window& other) const {
    bool inside = true;
    for (int k = 0; k < kAxes; ++k) inside &= other.low[k] >= low[k] && other.high[k] <= high[k];
    return inside;
  }
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
  /// Clears open[lane] for ways from an eye, given in the reference frame, that none of them overlaps.
  void narrow(const Lanes3& way, ViewAxes axes, int* open) const;

 private:
  int count_ = 0;
  Window frame_;
  alignas(64) float low_[Window::kAxes][kMost];
  alignas(64) float high_[Window::kAxes][kMost];
};

/// The least window around the ways from an eye to points, given in the reference frame; only those with
/// used > 0 count. In depth it begins at the eye.
Window window_of(const Lanes3& way, ViewAxes axes, const double* used);

/// Bundles of lines of sight, each with its window, in the frame of a shape.
class Sight {
 public:
  Sight(const Rigid3& shape_from_reference, const Eigen::Vector3d& eye_in_reference, ViewAxes axes,
        const Windows& bundles);

  const float* eye_in_shape() const { return eye_; }

  /// Windows in which the boxes of `those` (bits) are seen, and which of these may stand in a line of sight.
  unsigned see(const EightBoxes& boxes, unsigned those, Window* windows) const;

 private:
  float eye_[3];
  float axes_[3][3];  ///< of depth, across and along
  float slack_;       ///< room for rounding, m
  const Windows& bundles_;
};

}  // namespace sensor_rt
