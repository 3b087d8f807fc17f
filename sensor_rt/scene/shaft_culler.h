// Shaft culling: boxes projected to the image plane of a viewpoint, tested against bundles of lines of sight.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <limits>

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/scene/aabb8.h"

namespace sensor_rt {

/// Viewing axis of a viewpoint in the reference frame: the depth axis. The image axes are Y (across) and the
/// remaining one of Z and X (along).
enum class ViewAxes { kX, kBackX, kZ };

/// Bounds in the image plane and in depth: across / depth, along / depth, and depth (m).
struct ProjectedBounds {
  static constexpr float kInfinity = std::numeric_limits<float>::infinity();
  static constexpr int kAxes = 3;

  float low[kAxes] = {kInfinity, kInfinity, kInfinity};
  float high[kAxes] = {-kInfinity, -kInfinity, -kInfinity};

  static ProjectedBounds everything() {
    return {{-kInfinity, -kInfinity, -kInfinity}, {kInfinity, kInfinity, kInfinity}};
  }
  bool empty() const { return !(low[0] <= high[0]); }
  void include(const ProjectedBounds& other) {
    for (int k = 0; k < kAxes; ++k) {
      low[k] = std::min(low[k], other.low[k]);
      high[k] = std::max(high[k], other.high[k]);
    }
  }
  bool holds(const ProjectedBounds& other) const {
    bool inside = true;
    for (int k = 0; k < kAxes; ++k) inside &= other.low[k] >= low[k] && other.high[k] <= high[k];
    return inside;
  }
};

/// Small set of projected bounds.
class ProjectedBoundsSet {
 public:
  static constexpr int kCapacity = 64;

  int count() const { return count_; }
  /// Union of all bounds.
  const ProjectedBounds& frame() const { return frame_; }
  void clear();
  void add(const ProjectedBounds& bounds);
  /// Returns true when one of them overlaps `bounds`.
  bool overlaps(const ProjectedBounds& bounds) const;
  /// Clears open[lane] for points, as vectors from the viewpoint in the reference frame, that no bounds in
  /// the set contain.
  void narrow(const Lanes3& to_point, ViewAxes axes, int* open) const;

 private:
  int count_ = 0;
  ProjectedBounds frame_;
  alignas(64) float low_[ProjectedBounds::kAxes][kCapacity];
  alignas(64) float high_[ProjectedBounds::kAxes][kCapacity];
};

/// Returns the tightest bounds of points given as vectors from the viewpoint in the reference frame; only
/// those with used > 0 count. The depth range begins at the viewpoint.
ProjectedBounds projected_bounds(const Lanes3& to_point, ViewAxes axes, const double* used);

/// Tests boxes in the frame of a shape against bundles of lines of sight, given by their projected bounds.
class ShaftCuller {
 public:
  ShaftCuller(const Rigid3& shape_from_reference, const Eigen::Vector3d& viewpoint_in_reference,
              ViewAxes axes, const ProjectedBoundsSet& bundles);

  const float* viewpoint_in_shape() const { return viewpoint_; }

  /// ProjectedBoundsSet in which the boxes of `those` (bits) are seen, and which of these may stand in a line
  /// of sight.
  unsigned cull(const Aabb8& boxes, unsigned mask, ProjectedBounds* bounds) const;

 private:
  float viewpoint_[3];
  float axes_[3][3];  ///< axes of depth, across and along
  float slack_;       ///< tolerance for rounding, m
  const ProjectedBoundsSet& bundles_;
};

}  // namespace sensor_rt
