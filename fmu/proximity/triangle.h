// Rays against triangles and closed meshes.
#pragma once

#include <Eigen/Geometry>
#include <utility>

#include "fmu/proximity/body_set.h"

namespace robotcell::proximity {

/// Numbers of a face of one body and a face of another.
using FacePair = std::pair<std::size_t, std::size_t>;

/// Corners of a triangle of a mesh.
struct Corners {
  Eigen::Vector3d a, b, c;
};
Corners corners(const TriangleMesh& mesh, std::size_t face);

/// Distance along a ray to a triangle, in units of the direction; infinite where it misses. From behind as
/// well as from the front.
double meet(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction, const Corners& triangle);

/// Whether a point is inside a closed mesh: a ray from it leaves the mesh once more than it enters.
bool holds(const TriangleMesh& mesh, const Eigen::Vector3d& point);

}  // namespace robotcell::proximity
