// Intersection of rays with triangles, and point-in-mesh test.
#pragma once

#include <Eigen/Geometry>
#include <utility>

#include "fmu/proximity/body_set.h"

namespace robotcell::proximity {

/// Indices of a face of one body and of a face of another.
using FacePair = std::pair<std::size_t, std::size_t>;

/// Vertices of a triangle of a mesh.
struct Corners {
  Eigen::Vector3d a, b, c;
};
Corners corners(const TriangleMesh& mesh, std::size_t face);

/// Distance along a ray to a triangle, front or back face, in units of the direction; infinite where it
/// misses.
double intersect_ray(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                     const Corners& triangle);

/// Direction of the rays that find out whether points are inside: arbitrary, to avoid hitting edges.
const Eigen::Vector3d& inside_direction();

/// Whether a point is inside a closed mesh: a ray from it has an odd number of intersections.
bool contains(const TriangleMesh& mesh, const Eigen::Vector3d& point);

}  // namespace robotcell::proximity
