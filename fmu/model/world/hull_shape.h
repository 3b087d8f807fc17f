// Collision shapes of convex hulls.
#pragma once

#include <Eigen/Geometry>
#include <dart/dynamics/Shape.hpp>

#include "fmu/model/world/support_hull.h"

namespace robotcell {

/// A shape of the dynamics engine, and its pose in the frame of the hull's vertices.
struct PlacedShape {
  dart::dynamics::ShapePtr shape;
  Eigen::Isometry3d hull_from_shape = Eigen::Isometry3d::Identity();
};

/// A mesh that owns its data.
PlacedShape make_mesh_shape(const Hull& hull);

/// A box where the hull is one, else a mesh; for obstacles. Where a mesh slides over the seam between two
/// meshes of the same height it catches on their edges; on boxes it does not. The sliding body must be a
/// mesh, because ODE's box-box test loses contacts.
PlacedShape make_obstacle_shape(const Hull& hull);

}  // namespace robotcell
