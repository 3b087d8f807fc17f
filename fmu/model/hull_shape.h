// Collision shapes of convex hulls.
#pragma once

#include <Eigen/Geometry>
#include <dart/dynamics/Shape.hpp>

#include "fmu/model/support_hull.h"

namespace robotcell {

/// A shape of the dynamics engine, and where it lies in the frame of the hull's vertices.
struct PlacedShape {
  dart::dynamics::ShapePtr shape;
  Eigen::Isometry3d hull_from_shape = Eigen::Isometry3d::Identity();
};

/// A mesh that owns its data.
PlacedShape make_mesh_shape(const Hull& hull);

/// A box where the hull is one, else a mesh. For what stands still: at the seam between two bodies of the
/// same height, a mesh that slides over meshes catches on their edges, over boxes it does not. The sliding
/// body itself must be a mesh: the engine's test of box against box loses contacts now and then.
PlacedShape make_obstacle_shape(const Hull& hull);

}  // namespace robotcell
