// Bounding volumes of a mesh for distance queries: a sphere and an oriented box around every node of its
// tree.
#pragma once

#include <Eigen/Geometry>
#include <vector>

namespace robotcell::proximity {

struct Shape;

struct BoundingSphere {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // body frame, m
  double radius = 0;
};

/// Oriented box with the centre of the node's sphere.
struct BoundingBox {
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();  // columns, body frame
  Eigen::Vector3d half = Eigen::Vector3d::Zero();      // half of the edge lengths, m

  /// Half of the box's extent along a unit vector.
  double half_extent(const Eigen::Vector3d& direction) const {
    return (axes.transpose() * direction).cwiseAbs().dot(half);
  }
};

/// Binary tree over the faces of a shape. Node 0 is the root; a leaf holds one face.
class BoundingTree {
 public:
  explicit BoundingTree(const Shape& shape);

  const BoundingSphere& sphere(int node) const { return spheres_[static_cast<std::size_t>(node)]; }
  const BoundingBox& box(int node) const { return boxes_[static_cast<std::size_t>(node)]; }

  bool is_leaf(int node) const { return links_[static_cast<std::size_t>(node)] < 0; }

  /// First child of an inner node; the second child is the next node.
  int first_child(int node) const { return links_[static_cast<std::size_t>(node)]; }

  /// Number of a leaf's face.
  std::size_t face(int leaf) const {
    return static_cast<std::size_t>(-links_[static_cast<std::size_t>(leaf)] - 1);
  }

 private:
  void fit(const Shape& shape);

  std::vector<BoundingSphere> spheres_;
  std::vector<BoundingBox> boxes_;
  std::vector<int> links_;  // first child, or -1 - face
};

/// Vector that separates node boxes, given the pose of `b` in the frame of `a`, in which it is: all points of
/// `b` are beyond all points of `a` along it by at least its length (m). It is the gap between one box and
/// the other one's bounding box along its own axes, whichever is larger; the second is left out where the
/// first reaches `enough`.
Eigen::Vector3d box_gap(const BoundingBox& a, const BoundingBox& b, const Eigen::Matrix3d& a_from_b_rotation,
                        const Eigen::Vector3d& centre_a_to_b, double enough);

}  // namespace robotcell::proximity
