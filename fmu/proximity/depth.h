// Penetration depth of two bodies, and enclosure.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "fmu/proximity/triangle.h"

namespace robotcell::proximity {

struct Depth {
  double depth = 0;                                 // m
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // deepest point, world
};

/// Largest distance to the surface of the other body among the vertices and edges of either body that lie
/// inside the other one, near the intersecting faces. For bodies that touch at one place it is the distance
/// by which they must be separated; for deeply interpenetrating bodies only the rim is considered.
Depth depth_at(const BodySet::Body& a, const BodySet::Body& b, const std::vector<FacePair>& intersections);

/// Whether a connected piece of one body, whose surfaces do not intersect those of the other, lies inside it.
bool one_encloses_other(const BodySet::Body& a, const BodySet::Body& b);

/// Largest distance to the surface of the other body among the vertices of either body inside the other one,
/// for bodies whose surfaces do not intersect.
Depth depth_inside(const BodySet::Body& a, const BodySet::Body& b);

}  // namespace robotcell::proximity
