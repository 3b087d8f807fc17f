// The shape of a triangle mesh, and the passage to Embree.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>

#include "sensor_rt/scene/mesh_view.h"
#include "sensor_rt/scene/shape.h"

namespace sensor_rt {

/// Embree scene that holds the mesh shifted by -centre in single precision.
SceneHandle build_triangle_scene(const MeshView& mesh, const Eigen::Vector3d& centre);

/// Search trees over triangles that this process has built so far: tells whether anything is built again.
std::uint64_t tree_builds();

/// Shape of a valid mesh given in the body frame.
Shape make_mesh_shape(const MeshView& mesh);

}  // namespace sensor_rt
