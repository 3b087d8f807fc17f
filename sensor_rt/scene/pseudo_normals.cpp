#include "sensor_rt/scene/pseudo_normals.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

namespace sensor_rt {
namespace {

/// For each vertex the number of the place it stands at.
std::vector<std::uint32_t> weld(const MeshView& mesh) {
  std::vector<std::uint32_t> order(mesh.vertex_count);
  std::iota(order.begin(), order.end(), 0u);
  const auto key = [&](std::uint32_t i) {
    const double* v = mesh.vertices + 3 * std::size_t{i};
    return std::make_tuple(v[0], v[1], v[2]);
  };
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return key(a) < key(b); });
  std::vector<std::uint32_t> place(mesh.vertex_count);
  for (std::size_t i = 0; i < order.size(); ++i) {
    const bool same = i > 0 && key(order[i]) == key(order[i - 1]);
    place[order[i]] = same ? place[order[i - 1]] : order[i];
  }
  return place;
}

struct HalfEdge {
  std::uint32_t low;
  std::uint32_t high;
  std::uint32_t face;
  std::uint32_t side;

  bool operator<(const HalfEdge& other) const {
    return std::tie(low, high) < std::tie(other.low, other.high);
  }
};

double angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

}  // namespace

PseudoNormals::PseudoNormals(const MeshView& mesh)
    : faces_(mesh.face_count),
      face_normals_(mesh.face_count, Eigen::Vector3d::Zero()),
      vertex_normals_(mesh.vertex_count, Eigen::Vector3d::Zero()),
      edge_normals_(mesh.face_count) {
  const std::vector<std::uint32_t> place = weld(mesh);
  std::vector<HalfEdge> edges;
  edges.reserve(3 * mesh.face_count);
  for (std::size_t f = 0; f < mesh.face_count; ++f) {
    const Eigen::Vector3d corners[3] = {mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2)};
    const Eigen::Vector3d cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    if (cross.norm() > 0.0) face_normals_[f] = cross.normalized();
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t next = (k + 1) % 3;
      const std::size_t previous = (k + 2) % 3;
      faces_[f][k] = place[mesh.faces[3 * f + k]];
      const double angle = angle_between(corners[next] - corners[k], corners[previous] - corners[k]);
      vertex_normals_[faces_[f][k]] += angle * face_normals_[f];
    }
    for (std::uint32_t k = 0; k < 3; ++k) {
      const auto [low, high] = std::minmax(faces_[f][k], faces_[f][(k + 1) % 3]);
      edges.push_back({low, high, static_cast<std::uint32_t>(f), k});
    }
  }
  std::sort(edges.begin(), edges.end());
  for (auto first = edges.begin(); first != edges.end();) {
    const auto last = std::upper_bound(first, edges.end(), *first);
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (auto edge = first; edge != last; ++edge) sum += face_normals_[edge->face];
    for (auto edge = first; edge != last; ++edge) edge_normals_[edge->face][edge->side] = sum;
    first = last;
  }
}

Eigen::Vector3d PseudoNormals::at(std::size_t face, int feature) const {
  if (feature == kTriangleInside) return face_normals_[face];
  if (feature >= 3) return edge_normals_[face][static_cast<std::size_t>(feature - 3)];
  return vertex_normals_[faces_[face][static_cast<std::size_t>(feature)]];
}

}  // namespace sensor_rt
