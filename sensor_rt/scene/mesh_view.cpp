#include "sensor_rt/scene/mesh_view.h"

#include <cmath>
#include <limits>
#include <stdexcept>

namespace sensor_rt {

void validate_mesh(const MeshView& mesh, const std::string& what) {
  if (mesh.vertex_count == 0 || mesh.face_count == 0)
    throw std::invalid_argument(what + ": the mesh is empty");
  constexpr std::size_t kCapacity = std::numeric_limits<std::uint32_t>::max() / 4;
  if (mesh.vertex_count > kCapacity || mesh.face_count > kCapacity)
    throw std::invalid_argument(what + ": the mesh is too large");
  for (std::size_t i = 0; i < 3 * mesh.vertex_count; ++i) {
    if (!std::isfinite(mesh.vertices[i]) || std::abs(mesh.vertices[i]) > 1e6) {
      throw std::invalid_argument(what + ": vertex " + std::to_string(i / 3) +
                                  " is not finite or beyond 1000 km");
    }
  }
  for (std::size_t i = 0; i < 3 * mesh.face_count; ++i) {
    if (mesh.faces[i] >= mesh.vertex_count) {
      throw std::invalid_argument(what + ": face " + std::to_string(i / 3) + " names vertex " +
                                  std::to_string(mesh.faces[i]) + " of " + std::to_string(mesh.vertex_count));
    }
  }
}

Eigen::Vector3d mesh_centre(const MeshView& mesh) {
  Eigen::Vector3d low = mesh.vertex(0);
  Eigen::Vector3d high = low;
  for (std::size_t i = 1; i < mesh.vertex_count; ++i) {
    low = low.cwiseMin(mesh.vertex(i));
    high = high.cwiseMax(mesh.vertex(i));
  }
  return 0.5 * (low + high);
}

FacePlane face_plane(const MeshView& mesh, std::size_t face, const Eigen::Vector3d& centre) {
  const Eigen::Vector3d a = mesh.corner(face, 0) - centre;
  const Eigen::Vector3d b = mesh.corner(face, 1) - centre;
  const Eigen::Vector3d c = mesh.corner(face, 2) - centre;
  const Eigen::Vector3d cross = (b - a).cross(c - a);
  const double length = cross.norm();
  // Degenerate faces keep a zero normal and reflect nothing.
  const Eigen::Vector3d normal = length > 0.0 ? Eigen::Vector3d(cross / length) : Eigen::Vector3d::Zero();
  return {{normal.x(), normal.y(), normal.z()}, normal.dot(a)};
}

}  // namespace sensor_rt
