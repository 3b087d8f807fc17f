#include "sensor_rt/scene/back_face_tree.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/geometry/prefetch.h"
#include "sensor_rt/scene/spatial_order.h"

namespace sensor_rt {
namespace {

constexpr int kWide = Aabb8::kCount;
constexpr float kInfinity = ProjectedBounds::kInfinity;

/// Sets turned[node] to 1 where one of eight nodes may contain a back face as seen from the viewpoint.
/// `margin`: tolerance for rounding and for faces seen edge-on, m.
SENSOR_RT_MULTIVERSION
void back_facing(const Aabb8& __restrict normals, const float* __restrict offset,
                 const float* __restrict viewpoint, float margin, float* __restrict turned) {
  float least[kWide];  // lower bound of the viewpoint's signed distances to the planes
  for (int l = 0; l < kWide; ++l) least[l] = -offset[l] - margin;
  for (int k = 0; k < 3; ++k) {
    for (int l = 0; l < kWide; ++l) {
      const float low = viewpoint[k] * normals.low[k][l];
      const float high = viewpoint[k] * normals.high[k][l];
      least[l] += low < high ? low : high;
    }
  }
  for (int l = 0; l < kWide; ++l) turned[l] = least[l] > 0.0f ? 0.0f : 1.0f;
}

}  // namespace

BackFaceTree::BackFaceTree(const MeshView& mesh, const Eigen::Vector3d& centre,
                           const std::vector<FacePlane>& planes, const std::vector<std::uint32_t>& order) {
  double reach = 0.0;
  for (std::size_t v = 0; v < mesh.vertex_count; ++v)
    reach = std::max(reach, (mesh.vertex(v) - centre).cwiseAbs().maxCoeff());
  reach_ = static_cast<float>(3.0 * reach);
  add_leaves(mesh, centre, planes, order);
  while (levels_.back().size() > 1) add_level();
  std::reverse(levels_.begin(), levels_.end());
}

void BackFaceTree::add_leaves(const MeshView& mesh, const Eigen::Vector3d& centre,
                              const std::vector<FacePlane>& planes, const std::vector<std::uint32_t>& order) {
  std::vector<Block> blocks = empty_blocks((order.size() + kFacesPerLeaf - 1) / kFacesPerLeaf);
  for (std::size_t i = 0; i < order.size(); ++i) {
    const FacePlane& plane = planes[order[i]];
    const Eigen::Vector3d normal = Eigen::Map<const Eigen::Vector3d>(plane.normal);
    if (normal.isZero(0.0)) continue;  // degenerate faces do not occlude
    const std::size_t node = i / kFacesPerLeaf;
    const int slot = static_cast<int>(node % kWide);
    Block& block = blocks[node / kWide];
    for (int c = 0; c < 3; ++c) block.boxes.include(slot, mesh.corner(order[i], c) - centre);
    block.normals.include(slot, normal);
    block.offset[slot] = std::max(block.offset[slot], static_cast<float>(plane.offset));
  }
  levels_.push_back(std::move(blocks));
}

void BackFaceTree::add_level() {
  const std::vector<Block>& below = levels_.back();
  std::vector<Block> blocks = empty_blocks(below.size());
  for (std::size_t node = 0; node < below.size(); ++node) {
    Block& block = blocks[node / kWide];
    const int slot = static_cast<int>(node % kWide);
    for (int l = 0; l < kWide; ++l) {
      block.boxes.include(slot, below[node].boxes, l);
      block.normals.include(slot, below[node].normals, l);
      block.offset[slot] = std::max(block.offset[slot], below[node].offset[l]);
    }
  }
  levels_.push_back(std::move(blocks));
}

std::vector<BackFaceTree::Block> BackFaceTree::empty_blocks(std::size_t nodes) {
  std::vector<Block> blocks((nodes + kWide - 1) / kWide);
  for (Block& block : blocks) {
    block.boxes.clear();
    block.normals.clear();
    std::fill(block.offset, block.offset + kWide, -kInfinity);
  }
  return blocks;
}

void BackFaceTree::find_back_faces(const ShaftCuller& culler, ProjectedBoundsSet& found) const {
  const float* viewpoint = culler.viewpoint_in_shape();
  const float margin =
      1e-5f * (std::abs(viewpoint[0]) + std::abs(viewpoint[1]) + std::abs(viewpoint[2]) + reach_);
  found.clear();
  // Breadth-first traversal with a ring buffer. Nodes are no longer expanded once the number of bounds would
  // exceed the capacity.
  constexpr std::size_t kCapacity = ProjectedBoundsSet::kCapacity;
  Node nodes[kCapacity];
  nodes[0] = {0, 0, ProjectedBounds::everything()};
  std::size_t first = 0;
  std::size_t count = 1;
  bool is_full = false;
  while (count > 0) {
    const Node node = nodes[first];
    first = (first + 1) % kCapacity;
    --count;
    Node children[kWide];
    std::size_t born = 0;
    const bool is_face = node.level == levels_.size();
    if (!is_full && !is_face) born = expand(node, culler, margin, children);
    is_full = is_full || static_cast<std::size_t>(found.count()) + count + born > kCapacity;
    if (is_full || is_face) {
      found.add(node.bounds);
      continue;
    }
    for (std::size_t i = 0; i < born; ++i) nodes[(first + count++) % kCapacity] = children[i];
  }
}

std::size_t BackFaceTree::expand(const Node& node, const ShaftCuller& culler, float margin,
                                 Node* children) const {
  const Block& block = levels_[node.level][node.index];
  alignas(32) float turned[kWide];
  back_facing(block.normals, block.offset, culler.viewpoint_in_shape(), margin, turned);
  unsigned bits = 0;
  for (int l = 0; l < kWide; ++l) bits |= (turned[l] > 0.0f ? 1u : 0u) << l;
  ProjectedBounds seen[kWide];
  if (bits != 0) bits = culler.cull(block.boxes, bits, seen);
  const std::size_t level = node.level + 1;
  std::size_t count = 0;
  for (; bits != 0; bits &= bits - 1) {
    const int l = __builtin_ctz(bits);
    children[count] = {level, node.index * kWide + static_cast<std::uint32_t>(l), seen[l]};
    if (level < levels_.size()) prefetch(levels_[level][children[count].index]);
    ++count;
  }
  return count;
}

}  // namespace sensor_rt
