// The first faces of a fine mesh that a whole fan of rays meets.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/scene/fan_tree.h"
#include "sensor_rt/tracing/fan.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// The plane x = 0 of a fan as the frame of a shape sees it: of a point p, axis · p + offset is its height
/// over the plane, how far it lies along the fan's y, and its depth, all from the eye.
struct FanPlane {
  float axis[3][3];
  float offset[3];
  float slack;  ///< room for rounding, m
};

/// Segments in which a plane cuts sixteen faces.
struct alignas(64) Cuts {
  float first[FaceGroup::kCount];  ///< across
  float last[FaceGroup::kCount];
  float nearness[FaceGroup::kCount];  ///< 1 / depth at the first end
  float slope[FaceGroup::kCount];     ///< of nearness: over a straight line it is linear across
  std::int32_t first_ray[FaceGroup::kCount];
  std::int32_t end_ray[FaceGroup::kCount];
  unsigned met;  ///< a bit for each
};

/// Searches a tree for all rays of a fan together, roughly from the nearest nodes on.
///
/// Where faces are as fine as the rays, neighbouring rays share little of a search of their own. An even fan
/// cuts faces in segments of straight lines, each of which is some interval of rays; nodes that the plane
/// misses, that lie between two rays or behind what their rays have met are never visited. Memory is asked
/// for well before it is used. Neighbours that share an edge get the same numbers for its cut: nothing slips
/// through. Keeps scratch memory.
class FanSearch {
 public:
  /// `eye`: where the rays start, in the reference frame; `half_size` of the box around the shape. False, and
  /// nothing is known, for a fan that is not even, an empty tree, and shapes that reach as far back as the
  /// eye: these are left to packets of rays.
  bool search(const FanTree& tree, const FacePlane* planes, const Eigen::Vector3d& half_size,
              const Rigid3& shape_from_reference, const Eigen::Vector3d& eye, const Fan& fan);

  /// Of ray i, after a search: the face, and how far away it is in units of the ray's direction, in single
  /// precision; infinite where there is none.
  const std::uint32_t* faces() const { return face_.data(); }
  const float* distances() const { return t_.data(); }

 private:
  struct Node {
    std::uint32_t level;
    std::uint32_t index;
    float nearness;
    std::int32_t first;  ///< ray
    std::int32_t end;
  };

  /// So many nodes are on their way before the first is looked at.
  static constexpr std::size_t kBatch = 8;

  /// Nodes whose memory is on its way.
  class Queue {
   public:
    std::size_t count() const { return count_; }
    void push(const Node& node) { nodes_[(first_ + count_++) % kMost] = node; }
    Node pop() {
      const Node node = nodes_[first_];
      first_ = (first_ + 1) % kMost;
      --count_;
      return node;
    }

   private:
    static constexpr std::size_t kMost = 32;
    static_assert(kBatch + EightBoxes::kCount <= kMost);

    Node nodes_[kMost];
    std::size_t first_ = 0;
    std::size_t count_ = 0;
  };

  void descend(const FanTree& tree, const FacePlane* planes, const FanPlane& plane, const Fan& fan);
  bool is_hidden(const Node& node) const;
  void open(const FanTree& tree, const Node& node, const FanPlane& plane, const Fan& fan);
  void meet(const FanTree& tree, const FacePlane* planes, const FanPlane& plane, const Fan& fan);
  void draw(const FaceGroup& group, const Cuts& cuts, const FacePlane* planes, const float* across);

  std::vector<Node> stack_;
  Queue parents_;  ///< of leaves
  Queue leaves_;
  std::vector<float> nearness_;  ///< of each ray: 1 / depth of what it has met, 0 for nothing
  std::vector<std::uint32_t> face_;
  std::vector<float> t_;
};

}  // namespace sensor_rt
