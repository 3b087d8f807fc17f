// How far a mesh runs on around its vertices without end or bend.
#pragma once

#include <vector>

#include "sensor_rt/scene/mesh_view.h"

namespace sensor_rt {

/// Cosine between the normals of what may pass for one plane, 1.8 degrees.
constexpr double kParallel = 0.9995;

/// For each vertex the radius (m) of a disc around it that its faces fill, all of them as good as parallel;
/// 0 at borders and edges, and where faces do not share their vertices. `planes` one per face.
std::vector<float> flat_reach(const MeshView& mesh, const std::vector<FacePlane>& planes);

}  // namespace sensor_rt
