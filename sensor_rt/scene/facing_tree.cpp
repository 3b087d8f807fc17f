#include "sensor_rt/scene/facing_tree.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/geometry/prefetch.h"
#include "sensor_rt/scene/face_order.h"

namespace sensor_rt {
namespace {

constexpr int kWide = EightBoxes::kCount;
constexpr float kInfinity = Window::kInfinity;

/// For each of eight nodes 1 where it may hold a face that is turned away from the eye. `margin`: room for
/// rounding and for faces seen edge-on, m.
SENSOR_RT_MULTIVERSION
void turned_away(const EightBoxes& __restrict normals, const float* __restrict offset,
                 const float* __restrict eye, float margin, float* __restrict turned) {
  float least[kWide];  // of the eye's heights over the faces' planes
  for (int l = 0; l < kWide; ++l) least[l] = -offset[l] - margin;
  for (int k = 0; k < 3; ++k) {
    for (int l = 0; l < kWide; ++l) {
      const float low = eye[k] * normals.low[k][l];
      const float high = eye[k] * normals.high[k][l];
      least[l] += low < high ? low : high;
    }
  }
  for (int l = 0; l < kWide; ++l) turned[l] = least[l] > 0.0f ? 0.0f : 1.0f;
}

}  // namespace

FacingTree::FacingTree(const MeshView& mesh, const Eigen::Vector3d& centre,
                       const std::vector<FacePlane>& planes, const std::vector<std::uint32_t>& order) {
  double reach = 0.0;
  for (std::size_t v = 0; v < mesh.vertex_count; ++v)
    reach = std::max(reach, (mesh.vertex(v) - centre).cwiseAbs().maxCoeff());
  reach_ = static_cast<float>(3.0 * reach);
  add_leaves(mesh, centre, planes, order);
  while (levels_.back().size() > 1) add_level();
  std::reverse(levels_.begin(), levels_.end());
}

void FacingTree::add_leaves(const MeshView& mesh, const Eigen::Vector3d& centre,
                            const std::vector<FacePlane>& planes, const std::vector<std::uint32_t>& order) {
  std::vector<Block> blocks = empty_blocks((order.size() + kFacesPerLeaf - 1) / kFacesPerLeaf);
  for (std::size_t i = 0; i < order.size(); ++i) {
    const FacePlane& plane = planes[order[i]];
    const Eigen::Vector3d normal = Eigen::Map<const Eigen::Vector3d>(plane.normal);
    if (normal.isZero(0.0)) continue;  // a face without area hides nothing
    const std::size_t node = i / kFacesPerLeaf;
    const int slot = static_cast<int>(node % kWide);
    Block& block = blocks[node / kWide];
    for (int c = 0; c < 3; ++c) block.boxes.include(slot, mesh.corner(order[i], c) - centre);
    block.normals.include(slot, normal);
    block.offset[slot] = std::max(block.offset[slot], static_cast<float>(plane.offset));
  }
  levels_.push_back(std::move(blocks));
}

void FacingTree::add_level() {
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

std::vector<FacingTree::Block> FacingTree::empty_blocks(std::size_t nodes) {
  std::vector<Block> blocks((nodes + kWide - 1) / kWide);
  for (Block& block : blocks) {
    block.boxes.clear();
    block.normals.clear();
    std::fill(block.offset, block.offset + kWide, -kInfinity);
  }
  return blocks;
}

void FacingTree::find_turned_away(const Sight& sight, Windows& found) const {
  const float* eye = sight.eye_in_shape();
  const float margin = 1e-5f * (std::abs(eye[0]) + std::abs(eye[1]) + std::abs(eye[2]) + reach_);
  found.clear();
  // A ring of nodes, opened level by level; they stay closed once their children would be too many.
  constexpr std::size_t kMost = Windows::kMost;
  Node nodes[kMost];
  nodes[0] = {0, 0, Window::everything()};
  std::size_t first = 0;
  std::size_t count = 1;
  bool is_full = false;
  while (count > 0) {
    const Node node = nodes[first];
    first = (first + 1) % kMost;
    --count;
    Node children[kWide];
    std::size_t born = 0;
    const bool is_face = node.level == levels_.size();
    if (!is_full && !is_face) born = open(node, sight, margin, children);
    is_full = is_full || static_cast<std::size_t>(found.count()) + count + born > kMost;
    if (is_full || is_face) {
      found.add(node.window);
      continue;
    }
    for (std::size_t i = 0; i < born; ++i) nodes[(first + count++) % kMost] = children[i];
  }
}

std::size_t FacingTree::open(const Node& node, const Sight& sight, float margin, Node* children) const {
  const Block& block = levels_[node.level][node.index];
  alignas(32) float turned[kWide];
  turned_away(block.normals, block.offset, sight.eye_in_shape(), margin, turned);
  unsigned bits = 0;
  for (int l = 0; l < kWide; ++l) bits |= (turned[l] > 0.0f ? 1u : 0u) << l;
  Window seen[kWide];
  if (bits != 0) bits = sight.see(block.boxes, bits, seen);
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
