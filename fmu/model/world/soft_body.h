// Soft parts: a rigid core, and surface point masses connected to it by springs.
#pragma once

#include <dart/dynamics/ShapeNode.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <string>
#include <vector>

#include "fmu/model/description/part_description.h"
#include "fmu/model/world/soft_point.h"
#include "fmu/model/world/support_hull.h"

namespace robotcell {

/// Splits the edges of a surface, longest first, until none is longer than `longest_edge` (m) or the maximum
/// number of points is exceeded.
Hull refine(const Hull& hull, double longest_edge);

/// Creates a floating soft body with a hull as its surface and with mass, centre of mass and inertia of the
/// part. Throws DescriptionError where the hull needs too many points, or the inertia cannot be divided
/// between points and core.
dart::dynamics::SkeletonPtr make_soft_part(const std::string& name, const PartDescription& part,
                                           const Hull& hull, double time_step);

/// Shape of the surface of a soft part.
dart::dynamics::ShapeNode* soft_surface(dart::dynamics::BodyNode* body);

/// States of the surface points; empty for a rigid body.
std::vector<SoftPoint> soft_points(const dart::dynamics::BodyNode* body);
/// Restores the states of all surface points.
void restore_soft_points(dart::dynamics::BodyNode* body, const std::vector<SoftPoint>& points);

}  // namespace robotcell
