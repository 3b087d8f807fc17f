// The order in which trees hold the faces of a mesh.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/scene/mesh_view.h"

namespace sensor_rt {

constexpr std::size_t kFacesPerLeaf = 16;

/// Faces in an order in which each aligned block of a power of two of leaves is a compact piece of the mesh.
std::vector<std::uint32_t> order_in_space(const MeshView& mesh, const Eigen::Vector3d& centre);

}  // namespace sensor_rt
