#include "sensor_rt/scene/pseudo_normals.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>
#include <utility>

namespace sensor_rt {
namespace {

/// Returns for each vertex the index of its position, equal for vertices with equal coordinates.
std::vector<std::uint32_t> weld(const MeshView& mesh) {
  std::vector<std::uint32_t> order(mesh.vertex_count);
  std::iota(order.begin(), order.end(), 0u);
  const auto key = [&](std::uint32_t i) {
    const double* v = mesh.vertices + 3 * std::size_t{i};
    return std::make_tuple(v[0], v[1], v[2]);
  };
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return key(a) < key(b); });
  std::vector<std::uint32_t> welded(mesh.vertex_count);
  for (std::size_t i = 0; i < order.size(); ++i) {
    const bool same = i > 0 && key(order[i]) == key(order[i - 1]);
    welded[order[i]] = same ? welded[order[i - 1]] : order[i];
  }
  return welded;
}

double angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

}  // namespace

PseudoNormals::PseudoNormals(const MeshView& mesh)
    : faces_(mesh.face_count),
      face_normals_(mesh.face_count, Eigen::Vector3d::Zero()),
      vertex_normals_(mesh.vertex_count, Eigen::Vector3d::Zero()),
      next_half_edge_(3 * mesh.face_count) {
  const std::vector<std::uint32_t> welded = weld(mesh);
  for (std::size_t f = 0; f < mesh.face_count; ++f) {
    const Eigen::Vector3d corners[3] = {mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2)};
    const Eigen::Vector3d cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    if (cross.norm() > 0.0) face_normals_[f] = cross.normalized();
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t next = (k + 1) % 3;
      const std::size_t previous = (k + 2) % 3;
      faces_[f][k] = welded[mesh.faces[3 * f + k]];
      const double angle = angle_between(corners[next] - corners[k], corners[previous] - corners[k]);
      vertex_normals_[faces_[f][k]] += angle * face_normals_[f];
    }
  }
  link_half_edges();
}

void PseudoNormals::link_half_edges() {
  const auto ends = [&](std::uint32_t half_edge) {
    const std::array<std::uint32_t, 3>& corners = faces_[half_edge / 3];
    return std::minmax(corners[half_edge % 3], corners[(half_edge % 3 + 1) % 3]);
  };
  // Counting sort by the lower end; the write position of each vertex moves from its begin to its end.
  const auto count = static_cast<std::uint32_t>(next_half_edge_.size());
  std::vector<std::uint32_t> begin(vertex_normals_.size() + 2);
  for (std::uint32_t e = 0; e < count; ++e) ++begin[ends(e).first + std::size_t{2}];
  for (std::size_t v = 2; v < begin.size(); ++v) begin[v] += begin[v - 1];
  std::vector<std::uint32_t> order(count);
  for (std::uint32_t e = 0; e < count; ++e) order[begin[ends(e).first + std::size_t{1}]++] = e;
  const auto other_end_before = [&](std::uint32_t a, std::uint32_t b) {
    return std::make_pair(ends(a).second, a) < std::make_pair(ends(b).second, b);
  };
  for (std::size_t v = 0; v < vertex_normals_.size(); ++v) {
    std::sort(order.begin() + begin[v], order.begin() + begin[v + 1], other_end_before);
    for (std::uint32_t first = begin[v], last = first; first < begin[v + 1]; first = last) {
      while (last < begin[v + 1] && ends(order[last]).second == ends(order[first]).second) ++last;
      for (std::uint32_t k = first; k < last; ++k)
        next_half_edge_[order[k]] = order[k + 1 < last ? k + 1 : first];
    }
  }
}

Eigen::Vector3d PseudoNormals::at(std::size_t face, int feature) const {
  if (feature == kTriangleInside) return face_normals_[face];
  if (feature >= 3) {
    const auto start = static_cast<std::uint32_t>(3 * face) + static_cast<std::uint32_t>(feature - 3);
    Eigen::Vector3d sum = face_normals_[face];
    for (std::uint32_t e = next_half_edge_[start]; e != start; e = next_half_edge_[e])
      sum += face_normals_[e / 3];
    return sum;
  }
  return vertex_normals_[faces_[face][static_cast<std::size_t>(feature)]];
}

}  // namespace sensor_rt
