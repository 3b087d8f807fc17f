#include "sensor_rt/scene/planar_radii.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "sensor_rt/geometry/random.h"

namespace sensor_rt {
namespace {

using Normal = Eigen::Map<const Eigen::Vector3d>;

struct FacesAround {
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();  ///< sum over the faces
  float radius2 = std::numeric_limits<float>::infinity();
  std::uint64_t ends =
      0;  ///< hash of the end points of the opposite edges; 0 when these form closed loops around the vertex
};

double distance2(const Eigen::Vector3d& point, const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
  const Eigen::Vector3d edge = to - from;
  const double length2 = edge.squaredNorm();
  const double share = length2 > 0.0 ? std::clamp((point - from).dot(edge) / length2, 0.0, 1.0) : 0.0;
  return (from + share * edge - point).squaredNorm();
}

std::vector<FacesAround> gather(const MeshView& mesh, const std::vector<FacePlane>& planes) {
  std::vector<FacesAround> around(mesh.vertex_count);
  for (std::size_t f = 0; f < mesh.face_count; ++f) {
    const std::uint32_t* corner = mesh.faces + 3 * f;
    const Eigen::Vector3f normal = Normal(planes[f].normal).cast<float>();
    const Eigen::Vector3d at[3] = {mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2)};
    const std::uint64_t number[3] = {scramble(corner[0]), scramble(corner[1]), scramble(corner[2])};
    for (int k = 0; k < 3; ++k) {
      const int next = (k + 1) % 3;
      const int last = (k + 2) % 3;
      FacesAround& here = around[corner[k]];
      here.normal += normal;
      here.ends += number[next] - number[last];
      here.radius2 = std::min(here.radius2, static_cast<float>(distance2(at[k], at[next], at[last])));
    }
  }
  return around;
}

}  // namespace

std::vector<float> planar_radii(const MeshView& mesh, const std::vector<FacePlane>& planes) {
  std::vector<FacesAround> around = gather(mesh, planes);
  std::vector<float> reach(mesh.vertex_count);
  for (std::size_t v = 0; v < around.size(); ++v) {
    const bool closed = around[v].ends == 0 && around[v].radius2 < std::numeric_limits<float>::infinity();
    reach[v] = closed ? std::sqrt(around[v].radius2) : 0.0f;
    around[v].normal.normalize();
  }
  // Parallel faces whose opposite edges form closed loops around a vertex cover its neighbourhood without a
  // gap.
  for (std::size_t f = 0; f < mesh.face_count; ++f) {
    const Eigen::Vector3f normal = Normal(planes[f].normal).cast<float>();
    for (int k = 0; k < 3; ++k) {
      const std::uint32_t vertex = mesh.faces[3 * f + static_cast<std::size_t>(k)];
      if (!(normal.dot(around[vertex].normal) > static_cast<float>(kParallel))) reach[vertex] = 0.0f;
    }
  }
  return reach;
}

}  // namespace sensor_rt
