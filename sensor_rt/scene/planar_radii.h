// Radius of the planar neighbourhood of each vertex of a mesh.
#pragma once

#include <vector>

#include "sensor_rt/scene/mesh_view.h"

namespace sensor_rt {

/// Cosine between normals above which faces count as coplanar: 1.8 degrees.
constexpr double kParallel = 0.9995;

/// Returns for each vertex the radius (m) of a disc around it that is covered by its faces, all of them
/// nearly parallel; 0 at borders and edges, and where faces do not share vertices. `planes`: one per face.
std::vector<float> planar_radii(const MeshView& mesh, const std::vector<FacePlane>& planes);

}  // namespace sensor_rt
