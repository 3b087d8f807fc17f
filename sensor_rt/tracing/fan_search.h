// Closest hits of a fan of rays with a fine mesh.
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

/// The plane x = 0 of a fan in the frame of a shape. For a point p, axis · p + offset gives its height over
/// the plane, its coordinate along the fan's y and its depth, all relative to the viewpoint.
struct FanPlane {
  float axis[3][3];
  float offset[3];
  float slack;  ///< tolerance for rounding, m
};

/// Intersections of a plane with sixteen faces: one segment each.
struct alignas(64) Cuts {
  float first[FaceGroup::kCount];  ///< across
  float last[FaceGroup::kCount];
  float inverse_depth[FaceGroup::kCount];  ///< 1 / depth at the first end
  float slope[FaceGroup::kCount];          ///< of inverse_depth, which is linear in y / z along a segment
  std::int32_t first_ray[FaceGroup::kCount];
  std::int32_t end_ray[FaceGroup::kCount];
  unsigned met;  ///< bit mask of the intersected faces
};

/// Finds the closest hits of all rays of a fan in one traversal of a tree, approximately front to back.
///
/// For faces as fine as the ray spacing, packets of rays share little of their traversals. An even fan
/// intersects faces in straight segments, each of which covers an interval of rays; nodes that the plane
/// misses, that lie between two rays or that are occluded are not visited. Memory is prefetched well before
/// use. Neighbours compute identical intersections of their shared edge, so that the result is watertight.
/// Keeps scratch memory.
class FanSearch {
 public:
  /// `viewpoint`: origin of the rays in the reference frame; `half_size` of the bounding box of the shape.
  /// Returns false, with undefined results, for a fan that is not even, an empty tree, and shapes that extend
  /// behind the viewpoint; these are traced by packets.
  bool search(const FanTree& tree, const FacePlane* planes, const Eigen::Vector3d& half_size,
              const Rigid3& shape_from_reference, const Eigen::Vector3d& viewpoint, const Fan& fan);

  /// Results for ray i after a search: the face, and the distance in units of the ray's direction vector, in
  /// single precision; infinite without a hit.
  const std::uint32_t* faces() const { return face_.data(); }
  const float* distances() const { return t_.data(); }

 private:
  struct Node {
    std::uint32_t level;
    std::uint32_t index;
    float inverse_depth;
    std::int32_t first;  ///< ray
    std::int32_t end;
  };

  /// Number of prefetched nodes before the first is processed.
  static constexpr std::size_t kBatch = 8;

  /// Queue of prefetched nodes.
  class Queue {
   public:
    std::size_t count() const { return count_; }
    void push(const Node& node) { nodes_[(first_ + count_++) % kCapacity] = node; }
    Node pop() {
      const Node node = nodes_[first_];
      first_ = (first_ + 1) % kCapacity;
      --count_;
      return node;
    }

   private:
    static constexpr std::size_t kCapacity = 32;
    static_assert(kBatch + Aabb8::kCount <= kCapacity);

    Node nodes_[kCapacity];
    std::size_t first_ = 0;
    std::size_t count_ = 0;
  };

  void descend(const FanTree& tree, const FacePlane* planes, const FanPlane& plane, const Fan& fan);
  bool is_occluded(const Node& node) const;
  void expand(const FanTree& tree, const Node& node, const FanPlane& plane, const Fan& fan);
  void meet(const FanTree& tree, const FacePlane* planes, const FanPlane& plane, const Fan& fan);
  void draw(const FaceGroup& group, const Cuts& cuts, const FacePlane* planes, const float* across);

  std::vector<Node> stack_;
  Queue parents_;  ///< parents of leaves
  Queue leaves_;
  std::vector<float> inverse_depth_;  ///< per ray: 1 / depth of the closest hit, 0 without a hit
  std::vector<std::uint32_t> face_;
  std::vector<float> t_;
};

}  // namespace sensor_rt
