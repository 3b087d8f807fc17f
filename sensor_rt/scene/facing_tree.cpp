#include "sensor_rt/scene/facing_tree.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/scene/mesh_shape.h"

namespace sensor_rt {
namespace {

constexpr int kWide = EightBoxes::kCount;
constexpr std::size_t kFacesPerLeaf = 16;
constexpr float kInfinity = Window::kInfinity;

/// A number for a directed edge, the negative of that of the same edge run backwards. Sums of edges that do
/// not cancel out are as good as never zero (mixed as in SplitMix64).
std::uint64_t edge_number(std::uint32_t from, std::uint32_t to) {
  const bool forwards = from < to;
  std::uint64_t x = forwards ? (std::uint64_t{from} << 32 | to) : (std::uint64_t{to} << 32 | from);
  x += 0x9e3779b97f4a7c15u;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  x ^= x >> 31;
  return forwards ? x : std::uint64_t{0} - x;
}

struct Middle {
  float at[3];
  std::uint32_t face;
};

/// Sorts until the first half of any aligned block of a power of two of leaves lies on one side of the
/// second.
void split(Middle* first, std::size_t count) {
  if (count <= kFacesPerLeaf) return;
  std::size_t half = kFacesPerLeaf;
  while (2 * half < count) half *= 2;
  float low[3] = {kInfinity, kInfinity, kInfinity};
  float high[3] = {-kInfinity, -kInfinity, -kInfinity};
  for (std::size_t i = 0; i < count; ++i) {
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], first[i].at[k]);
      high[k] = std::max(high[k], first[i].at[k]);
    }
  }
  int axis = 0;
  for (int k = 1; k < 3; ++k) axis = high[k] - low[k] > high[axis] - low[axis] ? k : axis;
  // The number of the face settles ties: the tree does not depend on the library.
  std::nth_element(first, first + half, first + count, [axis](const Middle& a, const Middle& b) {
    return a.at[axis] < b.at[axis] || (a.at[axis] == b.at[axis] && a.face < b.face);
  });
  split(first, half);
  split(first + half, count - half);
}

/// Faces in an order in which each aligned block of a power of two of leaves is a compact piece of the mesh.
std::vector<std::uint32_t> order_in_space(const MeshView& mesh, const Eigen::Vector3d& centre) {
  std::vector<Middle> middles(mesh.face_count);
  for (std::size_t f = 0; f < mesh.face_count; ++f) {
    const Eigen::Vector3d middle = (mesh.corner(f, 0) + mesh.corner(f, 1) + mesh.corner(f, 2)) / 3.0 - centre;
    for (int k = 0; k < 3; ++k) middles[f].at[k] = static_cast<float>(middle[k]);
    middles[f].face = static_cast<std::uint32_t>(f);
  }
  split(middles.data(), middles.size());
  std::vector<std::uint32_t> order(mesh.face_count);
  std::transform(middles.begin(), middles.end(), order.begin(), [](const Middle& one) { return one.face; });
  return order;
}

/// Boxes that hold nothing.
void clear(EightBoxes& boxes) {
  std::fill(&boxes.low[0][0], &boxes.low[0][0] + 3 * kWide, kInfinity);
  std::fill(&boxes.high[0][0], &boxes.high[0][0] + 3 * kWide, -kInfinity);
}

void include(EightBoxes& to, int slot, const EightBoxes& from, int lane) {
  for (int k = 0; k < 3; ++k) {
    to.low[k][slot] = std::min(to.low[k][slot], from.low[k][lane]);
    to.high[k][slot] = std::max(to.high[k][slot], from.high[k][lane]);
  }
}

void include(EightBoxes& to, int slot, const Eigen::Vector3d& point) {
  for (int k = 0; k < 3; ++k) {
    to.low[k][slot] = std::min(to.low[k][slot], static_cast<float>(point[k]));
    to.high[k][slot] = std::max(to.high[k][slot], static_cast<float>(point[k]));
  }
}

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

bool is_closed(const MeshView& mesh) {
  std::uint64_t border = 0;
  for (std::size_t f = 0; f < mesh.face_count; ++f) {
    const std::uint32_t* corner = mesh.faces + 3 * f;
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t next = corner[(k + 1) % 3];
      if (corner[k] != next) border += edge_number(corner[k], next);
    }
  }
  return border == 0;
}

FacingTree::FacingTree(const MeshView& mesh, const Eigen::Vector3d& centre,
                       const std::vector<FacePlane>& planes) {
  if (!is_closed(mesh)) return;
  double reach = 0.0;
  for (std::size_t v = 0; v < mesh.vertex_count; ++v)
    reach = std::max(reach, (mesh.vertex(v) - centre).cwiseAbs().maxCoeff());
  reach_ = static_cast<float>(3.0 * reach);
  const std::vector<std::uint32_t> order = order_in_space(mesh, centre);
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
    for (int c = 0; c < 3; ++c) include(block.boxes, slot, mesh.corner(order[i], c) - centre);
    include(block.normals, slot, normal);
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
      include(block.boxes, slot, below[node].boxes, l);
      include(block.normals, slot, below[node].normals, l);
      block.offset[slot] = std::max(block.offset[slot], below[node].offset[l]);
    }
  }
  levels_.push_back(std::move(blocks));
}

std::vector<FacingTree::Block> FacingTree::empty_blocks(std::size_t nodes) {
  std::vector<Block> blocks((nodes + kWide - 1) / kWide);
  for (Block& block : blocks) {
    clear(block.boxes);
    clear(block.normals);
    std::fill(block.offset, block.offset + kWide, -kInfinity);
  }
  return blocks;
}

void FacingTree::find_turned_away(const Sight& sight, Windows& found) const {
  found.clear();
  found.add(Window::everything());
  const float* eye = sight.eye_in_shape();
  const float margin = 1e-5f * (std::abs(eye[0]) + std::abs(eye[1]) + std::abs(eye[2]) + reach_);
  std::uint32_t nodes[Windows::kMost] = {0};
  int count = 1;
  for (const std::vector<Block>& level : levels_) {
    Windows windows;
    std::uint32_t next[Windows::kMost];
    for (int n = 0; n < count; ++n) {
      const Block& block = level[nodes[n]];
      alignas(32) float turned[kWide];
      turned_away(block.normals, block.offset, eye, margin, turned);
      unsigned bits = 0;
      for (int l = 0; l < kWide; ++l) bits |= (turned[l] > 0.0f ? 1u : 0u) << l;
      Window seen[kWide];
      if (bits != 0) bits = sight.see(block.boxes, bits, seen);
      for (int l = 0; l < kWide; ++l) {
        if ((bits >> l & 1u) == 0) continue;
        if (windows.count() == Windows::kMost) return;
        next[windows.count()] = nodes[n] * kWide + static_cast<std::uint32_t>(l);
        windows.add(seen[l]);
      }
    }
    count = windows.count();
    found = windows;
    std::copy_n(next, count, nodes);
  }
}

}  // namespace sensor_rt
