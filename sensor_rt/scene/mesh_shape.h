// Triangle meshes: validation and the passage to Embree.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>
#include <string>

#include "sensor_rt/scene/shape.h"

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

/// Throws std::invalid_argument, naming `what`, when the mesh is empty, too large, has a vertex that is not
/// finite or an index out of range.
void validate_mesh(const MeshView& mesh, const std::string& what);

/// Centre of the bounding box.
Eigen::Vector3d mesh_centre(const MeshView& mesh);

/// Embree scene that holds the mesh shifted by -centre in single precision.
SceneHandle build_triangle_scene(const MeshView& mesh, const Eigen::Vector3d& centre);

/// Search trees over triangles that this process has built so far: tells whether anything is built again.
std::uint64_t tree_builds();

/// Shape of a valid mesh given in the body frame.
Shape make_mesh_shape(const MeshView& mesh);

}  // namespace sensor_rt
