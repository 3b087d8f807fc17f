// Spatial order of the faces of a mesh, for building trees.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/scene/mesh_view.h"

namespace sensor_rt {

constexpr std::size_t kFacesPerLeaf = 16;

/// Returns the face indices in an order in which each aligned power-of-two block of leaves is spatially
/// compact.
std::vector<std::uint32_t> spatial_order(const MeshView& mesh, const Eigen::Vector3d& centre);

}  // namespace sensor_rt
