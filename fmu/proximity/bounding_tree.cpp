#include "fmu/proximity/bounding_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "fmu/proximity/collision_body.h"

namespace robotcell::proximity {

using Eigen::Matrix3d;
using Eigen::Vector3d;

BoundingTree::BoundingTree(const Shape& shape) {
  const int count = shape.model.getNumBVs();
  spheres_.resize(static_cast<std::size_t>(count));
  boxes_.resize(static_cast<std::size_t>(count));
  for (int i = 0; i < count; ++i) {
    const auto& node = shape.model.getBV(i);
    links_.push_back(node.isLeaf() ? -node.primitiveId() - 1 : node.leftChild());
    // A face without area has no axes.
    const Matrix3d& axes = node.bv.obb.axis;
    if ((axes.transpose() * axes).isIdentity(1e-9)) boxes_[static_cast<std::size_t>(i)].axes = axes;
  }
  fit(shape);
}

void BoundingTree::fit(const Shape& shape) {
  std::vector<int> parents(links_.size(), -1);
  for (int node = 0; node < static_cast<int>(links_.size()); ++node) {
    if (is_leaf(node)) continue;
    for (int child : {first_child(node), first_child(node) + 1})
      parents[static_cast<std::size_t>(child)] = node;
  }
  // Calls `extend(node, point)` for every node and every vertex of its faces.
  const auto for_each_vertex = [&](const auto& extend) {
    for (int leaf = 0; leaf < static_cast<int>(links_.size()); ++leaf) {
      if (!is_leaf(leaf)) continue;
      for (const int vertex : shape.mesh.faces[face(leaf)]) {
        const Vector3d& point = shape.mesh.vertices[static_cast<std::size_t>(vertex)];
        for (int node = leaf; node >= 0; node = parents[static_cast<std::size_t>(node)]) {
          extend(static_cast<std::size_t>(node), point);
        }
      }
    }
  };
  std::vector<Eigen::AlignedBox3d> extents(links_.size());
  for_each_vertex([&](std::size_t node, const Vector3d& point) {
    extents[node].extend(boxes_[node].axes.transpose() * point);
  });
  for (std::size_t node = 0; node < links_.size(); ++node) {
    spheres_[node].centre = boxes_[node].axes * extents[node].center();
    boxes_[node].half = extents[node].sizes() / 2;
  }
  for_each_vertex([&](std::size_t node, const Vector3d& point) {
    spheres_[node].radius = std::max(spheres_[node].radius, (point - spheres_[node].centre).norm());
  });
}

Vector3d box_gap(const BoundingBox& a, const BoundingBox& b, const Matrix3d& a_from_b_rotation,
                 const Vector3d& centre_a_to_b, double enough) {
  const Matrix3d axes_b = a_from_b_rotation * b.axes;
  const Matrix3d cosines = (a.axes.transpose() * axes_b).cwiseAbs();
  const auto outside = [](const Vector3d& centre, const Vector3d& half) -> Vector3d {
    return (centre.cwiseAbs() - half).cwiseMax(0).cwiseProduct(centre.cwiseSign());
  };
  const Vector3d along_a = outside(a.axes.transpose() * centre_a_to_b, a.half + cosines * b.half);
  const double by_a = along_a.squaredNorm();
  if (by_a >= enough * enough) return a.axes * along_a;
  const Vector3d along_b = outside(axes_b.transpose() * centre_a_to_b, b.half + cosines.transpose() * a.half);
  return by_a >= along_b.squaredNorm() ? Vector3d(a.axes * along_a) : Vector3d(axes_b * along_b);
}

}  // namespace robotcell::proximity
