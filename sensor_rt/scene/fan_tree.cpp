#include "sensor_rt/scene/fan_tree.h"

#include <algorithm>
#include <utility>

namespace sensor_rt {
namespace {

constexpr std::size_t kWide = Aabb8::kCount;

/// Returns the blocks for a number of nodes. Unused boxes are empty.
LargeVector<Aabb8> empty_blocks(std::size_t nodes) {
  LargeVector<Aabb8> blocks((nodes + kWide - 1) / kWide);
  for (Aabb8& block : blocks) block.clear();
  return blocks;
}

}  // namespace

FanTree::FanTree(const MeshView& mesh, const Eigen::Vector3d& centre,
                 const std::vector<std::uint32_t>& order) {
  add_groups(mesh, centre, order);
  add_leaves();
  while (levels_.back().size() > 1) add_level();
  std::reverse(levels_.begin(), levels_.end());
}

void FanTree::add_groups(const MeshView& mesh, const Eigen::Vector3d& centre,
                         const std::vector<std::uint32_t>& order) {
  groups_.resize((order.size() + kFacesPerLeaf - 1) / kFacesPerLeaf);
  for (std::size_t i = 0; i < groups_.size() * kFacesPerLeaf; ++i) {
    // Unused slots repeat the last face, shrunk to a point.
    const std::uint32_t face = order[std::min(i, order.size() - 1)];
    FaceGroup& group = groups_[i / kFacesPerLeaf];
    const std::size_t l = i % kFacesPerLeaf;
    group.face[l] = face;
    for (int c = 0; c < 3; ++c) {
      const Eigen::Vector3d corner = mesh.corner(face, i < order.size() ? c : 0) - centre;
      for (int k = 0; k < 3; ++k) group.corner[c][k][l] = static_cast<float>(corner[k]);
    }
  }
}

void FanTree::add_leaves() {
  LargeVector<Aabb8> blocks = empty_blocks(groups_.size());
  for (std::size_t node = 0; node < groups_.size(); ++node) {
    for (const auto& corner : groups_[node].corner) {
      for (int l = 0; l < FaceGroup::kCount; ++l) {
        blocks[node / kWide].include(
            static_cast<int>(node % kWide),
            Eigen::Vector3f(corner[0][l], corner[1][l], corner[2][l]).cast<double>());
      }
    }
  }
  levels_.push_back(std::move(blocks));
}

void FanTree::add_level() {
  const LargeVector<Aabb8>& below = levels_.back();
  LargeVector<Aabb8> blocks = empty_blocks(below.size());
  for (std::size_t node = 0; node < below.size(); ++node) {
    for (int l = 0; l < Aabb8::kCount; ++l) {
      blocks[node / kWide].include(static_cast<int>(node % kWide), below[node], l);
    }
  }
  levels_.push_back(std::move(blocks));
}

}  // namespace sensor_rt
