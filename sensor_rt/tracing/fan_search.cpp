#include "sensor_rt/tracing/fan_search.h"

#include <algorithm>
#include <limits>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/geometry/prefetch.h"

namespace sensor_rt {
namespace {

constexpr int kWide = Aabb8::kCount;
constexpr int kFaces = FaceGroup::kCount;
constexpr float kSlack = 1e-6f;  ///< relative

/// Packs flags of value 1 or 0 into a bit mask.
template <int kCount>
inline unsigned bits_of(const std::int32_t* flags) {
  unsigned bits = 0;
  for (int l = 0; l < kCount; ++l) bits |= static_cast<unsigned>(flags[l]) << l;
  return bits;
}

/// Projections of eight boxes to the fan: inverse depth and interval of rays.
struct alignas(64) ProjectedBoxes {
  float inverse_depth[kWide];
  std::int32_t first[kWide];  ///< ray
  std::int32_t end[kWide];
  unsigned met;  ///< bit mask
};

SENSOR_RT_MULTIVERSION
void see_boxes(const Aabb8& __restrict boxes, const FanPlane& __restrict plane,
               const Fan::Numbering& __restrict rays, ProjectedBoxes& __restrict seen) {
  alignas(64) std::int32_t met[kWide];
  for (int l = 0; l < kWide; ++l) {
    float low[3];
    float high[3];
    for (int a = 0; a < 3; ++a) {
      low[a] = plane.offset[a] - plane.slack;
      high[a] = plane.offset[a] + plane.slack;
      for (int k = 0; k < 3; ++k) {
        const float one = plane.axis[a][k] * boxes.low[k][l];
        const float other = plane.axis[a][k] * boxes.high[k][l];
        low[a] += one < other ? one : other;
        high[a] += one < other ? other : one;
      }
    }
    const std::int32_t first = rays.first(low[1] / (low[1] < 0.0f ? low[2] : high[2]));
    const std::int32_t end = rays.end(high[1] / (high[1] < 0.0f ? high[2] : low[2]));
    seen.inverse_depth[l] = 1.0f / low[2];
    seen.first[l] = first;
    seen.end[l] = end;
    met[l] = (low[0] <= 0.0f) & (high[0] >= 0.0f) & (first < end) ? 1 : 0;
  }
  seen.met = bits_of<kWide>(met);
}

SENSOR_RT_MULTIVERSION
void cut_faces(const FaceGroup& __restrict group, const FanPlane& __restrict plane,
               const Fan::Numbering& rays, Cuts& __restrict cuts) {
  alignas(64) std::int32_t met[kFaces];
  for (int l = 0; l < kFaces; ++l) {
    float p[3][3];  // [corner]: height, along y, depth
    for (int c = 0; c < 3; ++c) {
      for (int a = 0; a < 3; ++a) {
        p[c][a] = plane.axis[a][0] * group.corner[c][0][l] + plane.axis[a][1] * group.corner[c][1][l] +
                  plane.axis[a][2] * group.corner[c][2][l] + plane.offset[a];
      }
    }
    const bool above0 = p[0][0] >= 0.0f;
    const bool above1 = p[1][0] >= 0.0f;
    const bool above2 = p[2][0] >= 0.0f;
    // The plane intersects the two edges of the corner that is alone on its side.
    const bool alone1 = (above0 == above2) & (above0 != above1);
    const bool alone2 = (above0 == above1) & (above0 != above2);
    const bool cut = (above0 != above1) | (above0 != above2);
    float lone[3];
    float one[3];
    float other[3];
    for (int a = 0; a < 3; ++a) {
      lone[a] = alone2 ? p[2][a] : alone1 ? p[1][a] : p[0][a];
      one[a] = alone1 ? p[0][a] : p[1][a];
      one[a] = alone2 ? p[0][a] : one[a];
      other[a] = alone2 ? p[1][a] : p[2][a];
    }
    // Reversing an edge changes all signs, so that both its faces get the same intersection.
    const float depth1 = lone[2] * one[0] - one[2] * lone[0];
    const float depth2 = lone[2] * other[0] - other[2] * lone[0];
    const float inverse1 = 1.0f / depth1;
    const float inverse2 = 1.0f / depth2;
    const float across1 = (lone[1] * one[0] - one[1] * lone[0]) * inverse1;
    const float across2 = (lone[1] * other[0] - other[1] * lone[0]) * inverse2;
    const float inverse_depth1 = (one[0] - lone[0]) * inverse1;
    const float inverse_depth2 = (other[0] - lone[0]) * inverse2;
    const float length = across2 - across1;
    const float first = across1 < across2 ? across1 : across2;
    const float last = across1 < across2 ? across2 : across1;
    cuts.first[l] = first;
    cuts.last[l] = last;
    cuts.inverse_depth[l] = across1 < across2 ? inverse_depth1 : inverse_depth2;
    cuts.slope[l] = length == 0.0f ? 0.0f : (inverse_depth2 - inverse_depth1) / length;
    const std::int32_t first_ray = rays.first(first);
    const std::int32_t end_ray = rays.end(last);
    cuts.first_ray[l] = first_ray;
    cuts.end_ray[l] = end_ray;
    met[l] = cut & (first_ray < end_ray) ? 1 : 0;
  }
  cuts.met = bits_of<kFaces>(met);
}

FanPlane fan_plane(const Rigid3& shape_from_reference, const Eigen::Vector3d& viewpoint) {
  FanPlane plane;
  const Eigen::Vector3d viewpoint_in_shape = shape_from_reference * viewpoint;
  for (int a = 0; a < 3; ++a) {
    const Eigen::Vector3d axis = shape_from_reference.rotation.col(a);
    for (int k = 0; k < 3; ++k) plane.axis[a][k] = static_cast<float>(axis[k]);
    plane.offset[a] = static_cast<float>(-axis.dot(viewpoint_in_shape));
  }
  plane.slack = kSlack * static_cast<float>(viewpoint_in_shape.norm());
  return plane;
}

/// Returns true when none of `count` inverse depths is smaller or equal. Always reads sixteen values.
SENSOR_RT_MULTIVERSION
bool all_nearer(const float* __restrict inverse_depth, std::int32_t count, float than) {
  std::int32_t expand = 0;
  for (std::int32_t l = 0; l < kLanes; ++l) expand |= (l < count) & (inverse_depth[l] <= than) ? 1 : 0;
  return expand == 0;
}

SENSOR_RT_MULTIVERSION
void find_distances(const float* __restrict inverse_depth, const float* __restrict towards, std::size_t count,
                    float* __restrict t) {
  // 1 / 0 = infinity is the correct result here.
  for (std::size_t i = 0; i < count; ++i) t[i] = 1.0f / (inverse_depth[i] * towards[i]);
}

}  // namespace

bool FanSearch::search(const FanTree& tree, const FacePlane* planes, const Eigen::Vector3d& half_size,
                       const Rigid3& shape_from_reference, const Eigen::Vector3d& viewpoint, const Fan& fan) {
  if (tree.empty() || !fan.is_even()) return false;
  const FanPlane plane = fan_plane(shape_from_reference, viewpoint);
  const Eigen::Vector3d depth = shape_from_reference.rotation.col(2);
  const double nearest = static_cast<double>(plane.offset[2]) - depth.cwiseAbs().dot(half_size);
  constexpr double kNearest = 1e-3;  // m
  if (nearest < kNearest) return false;
  const std::size_t padded = fan.directions().size() * kLanes;
  inverse_depth_.assign(padded + kLanes, 0.0f);
  face_.assign(padded, 0);
  t_.resize(padded);
  descend(tree, planes, plane, fan);
  find_distances(inverse_depth_.data(), fan.towards(), padded, t_.data());
  return true;
}

void FanSearch::descend(const FanTree& tree, const FacePlane* planes, const FanPlane& plane, const Fan& fan) {
  stack_.clear();
  stack_.push_back({0, 0, std::numeric_limits<float>::infinity(), 0, static_cast<std::int32_t>(fan.count())});
  while (true) {
    const bool above_parents = !stack_.empty();
    if (leaves_.count() >= kBatch || (!above_parents && parents_.count() == 0)) {
      if (leaves_.count() == 0) return;
      meet(tree, planes, plane, fan);
    } else if (parents_.count() >= kBatch || !above_parents) {
      expand(tree, parents_.pop(), plane, fan);
    } else {
      const Node node = stack_.back();
      stack_.pop_back();
      expand(tree, node, plane, fan);
    }
  }
}

bool FanSearch::is_occluded(const Node& node) const {
  for (std::int32_t i = node.first; i < node.end; i += kLanes) {
    if (!all_nearer(&inverse_depth_[static_cast<std::size_t>(i)], node.end - i, node.inverse_depth))
      return false;
  }
  return true;
}

void FanSearch::expand(const FanTree& tree, const Node& node, const FanPlane& plane, const Fan& fan) {
  if (is_occluded(node)) return;
  ProjectedBoxes seen;
  see_boxes(tree.levels()[node.level][node.index], plane, fan.numbering(node.first, node.end), seen);
  const std::size_t depth = tree.levels().size();
  const std::uint32_t level = node.level + 1;
  const std::size_t nodes = level < depth ? tree.levels()[level].size() : tree.groups().size();
  const std::size_t below = stack_.size();
  for (unsigned bits = seen.met; bits != 0; bits &= bits - 1) {
    const int l = __builtin_ctz(bits);
    const Node child{level, node.index * kWide + static_cast<std::uint32_t>(l), seen.inverse_depth[l],
                     seen.first[l], seen.end[l]};
    if (child.index >= nodes) break;
    if (level == depth) {
      prefetch(tree.groups()[child.index]);
      leaves_.push(child);
      continue;
    }
    prefetch(tree.levels()[level][child.index]);
    if (level + 1 == depth) {
      parents_.push(child);
      continue;
    }
    // The nearest node is on top of the stack.
    std::size_t at = stack_.size();
    stack_.push_back(child);
    for (; at > below && stack_[at - 1].inverse_depth > child.inverse_depth; --at)
      stack_[at] = stack_[at - 1];
    stack_[at] = child;
  }
}

void FanSearch::meet(const FanTree& tree, const FacePlane* planes, const FanPlane& plane, const Fan& fan) {
  // Processed in a batch, so that the latencies of the independent random accesses overlap.
  const FaceGroup* groups[kBatch];
  Cuts cuts[kBatch];
  const std::size_t count = std::min(kBatch, leaves_.count());
  for (std::size_t k = 0; k < count; ++k) {
    const Node leaf = leaves_.pop();
    groups[k] = &tree.groups()[leaf.index];
    cut_faces(*groups[k], plane, fan.numbering(leaf.first, leaf.end), cuts[k]);
  }
  for (std::size_t k = 0; k < count; ++k) draw(*groups[k], cuts[k], planes, fan.across());
}

void FanSearch::draw(const FaceGroup& group, const Cuts& cuts, const FacePlane* planes, const float* across) {
  for (unsigned bits = cuts.met; bits != 0; bits &= bits - 1) {
    const int l = __builtin_ctz(bits);
    for (std::int32_t ray = cuts.first_ray[l]; ray < cuts.end_ray[l]; ++ray) {
      const auto i = static_cast<std::size_t>(ray);
      const float inverse_depth = cuts.inverse_depth[l] + (across[i] - cuts.first[l]) * cuts.slope[l];
      const bool on_it = (across[i] >= cuts.first[l]) & (across[i] <= cuts.last[l]);
      if (!(on_it & (inverse_depth > inverse_depth_[i]))) continue;
      inverse_depth_[i] = inverse_depth;
      face_[i] = group.face[l];
      __builtin_prefetch(&planes[face_[i]]);
    }
  }
}

}  // namespace sensor_rt
