// Non-owning view of a triangle mesh, and its basic properties.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>
#include <string>

namespace sensor_rt {

/// View of a mesh: vertices (count, 3) in metres, faces (count, 3) of vertex indices; both row-major.
struct MeshView {
  const double* vertices = nullptr;
  std::size_t vertex_count = 0;
  const std::uint32_t* faces = nullptr;
  std::size_t face_count = 0;

  Eigen::Vector3d vertex(std::size_t index) const {
    return Eigen::Map<const Eigen::Vector3d>(vertices + 3 * index);
  }
  Eigen::Vector3d corner(std::size_t face, int k) const {
    return vertex(faces[3 * face + static_cast<std::size_t>(k)]);
  }
};

/// Throws std::invalid_argument that names `what` when the mesh is empty or too large, or has a vertex that
/// is not finite or an index out of range.
void validate_mesh(const MeshView& mesh, const std::string& what);

/// Returns the centre of the bounding box.
Eigen::Vector3d mesh_centre(const MeshView& mesh);

/// Plane of a face: normal · p = offset, unit normal, in the frame of the shape.
struct FacePlane {
  double normal[3];
  double offset;
};

/// Returns the plane of a face of a mesh shifted by -centre.
FacePlane face_plane(const MeshView& mesh, std::size_t face, const Eigen::Vector3d& centre);

}  // namespace sensor_rt
