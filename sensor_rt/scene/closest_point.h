// Exact closest points on a triangle mesh.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/scene/mesh_shape.h"

namespace sensor_rt {

/// Per query point: the nearest point of the surface, the face it lies on, and the distance, negative inside.
/// The sign means something for closed meshes with outward faces only.
struct ClosestPoints {
  std::vector<Eigen::Vector3d> point;
  std::vector<std::uint32_t> face;
  std::vector<double> signed_distance;
};

/// `points` is (count, 3), row-major, in the frame of the mesh. Double precision throughout; Embree only
/// narrows down the faces to look at. Throws std::invalid_argument for a bad mesh or a point that is not
/// finite.
ClosestPoints closest_points(const MeshView& mesh, const double* points, std::size_t count, unsigned threads);

}  // namespace sensor_rt
