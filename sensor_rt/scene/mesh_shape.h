// Shapes from triangle meshes.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/scene/mesh_view.h"
#include "sensor_rt/scene/shape.h"

namespace sensor_rt {

/// Returns an Embree scene with the mesh shifted by -centre, in single precision.
SceneHandle build_triangle_scene(const MeshView& mesh, const Eigen::Vector3d& centre);

/// Returns the number of triangle search trees that this process has built; for checking that nothing is
/// rebuilt.
std::uint64_t tree_builds();

/// Exact surfaces of faces: `curved_of_face` numbers those of each face in `curved`, -1: the face is flat.
/// Both are empty for a plain mesh.
struct ExactFaces {
  std::vector<CurvedFace> curved;  ///< in the body frame: `face_from_shape` is `face_from_body`
  std::vector<std::int32_t> curved_of_face;
};

/// Returns the shape of a valid mesh given in the body frame.
Shape make_mesh_shape(const MeshView& mesh, const ExactFaces& exact = {});

}  // namespace sensor_rt
