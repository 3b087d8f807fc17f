// A convex hull as a collision shape of the dynamics engine.
#pragma once

#include <Eigen/Core>
#include <array>
#include <dart/dynamics/SmartPointer.hpp>
#include <vector>

namespace robotcell {

/// Builds a mesh shape that owns its data. Vertices in metres, faces counter-clockwise from outside.
dart::dynamics::ShapePtr make_hull_shape(const std::vector<Eigen::Vector3d>& vertices,
                                         const std::vector<std::array<int, 3>>& faces);

}  // namespace robotcell
