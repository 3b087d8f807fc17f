#include "sensor_rt/scene/fan_tree.h"

#include <algorithm>
#include <limits>
#include <utility>

namespace sensor_rt {
namespace {

constexpr std::size_t kWide = NodeBoxes::kCount;
constexpr float kInfinity = std::numeric_limits<float>::infinity();

/// Blocks for so many nodes. Boxes that are left over hold nothing.
LargeVector<NodeBoxes> empty_blocks(std::size_t nodes) {
  LargeVector<NodeBoxes> blocks((nodes + kWide - 1) / kWide);
  for (NodeBoxes& block : blocks) {
    std::fill(&block.low[0][0], &block.low[0][0] + 3 * kWide, kInfinity);
    std::fill(&block.high[0][0], &block.high[0][0] + 3 * kWide, -kInfinity);
  }
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
    // The last face again, shrunk to a point, in places that are left over.
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
  LargeVector<NodeBoxes> blocks = empty_blocks(groups_.size());
  for (std::size_t node = 0; node < groups_.size(); ++node) {
    NodeBoxes& block = blocks[node / kWide];
    for (int c = 0; c < 3; ++c) {
      for (int k = 0; k < 3; ++k) {
        const float* at = groups_[node].corner[c][k];
        float& low = block.low[k][node % kWide];
        float& high = block.high[k][node % kWide];
        low = std::min(low, *std::min_element(at, at + FaceGroup::kCount));
        high = std::max(high, *std::max_element(at, at + FaceGroup::kCount));
      }
    }
  }
  levels_.push_back(std::move(blocks));
}

void FanTree::add_level() {
  const LargeVector<NodeBoxes>& below = levels_.back();
  LargeVector<NodeBoxes> blocks = empty_blocks(below.size());
  for (std::size_t node = 0; node < below.size(); ++node) {
    NodeBoxes& block = blocks[node / kWide];
    for (int k = 0; k < 3; ++k) {
      block.low[k][node % kWide] = *std::min_element(below[node].low[k], below[node].low[k] + kWide);
      block.high[k][node % kWide] = *std::max_element(below[node].high[k], below[node].high[k] + kWide);
    }
  }
  levels_.push_back(std::move(blocks));
}

}  // namespace sensor_rt
