// Soft parts: a rigid core, and points of mass around it that springs hold to their places.
#pragma once

#include <dart/dynamics/ShapeNode.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <string>
#include <vector>

#include "fmu/model/part_description.h"
#include "fmu/model/soft_point.h"
#include "fmu/model/support_hull.h"

namespace robotcell {

/// A surface whose edges are halved, the longest first, until none is longer than a length (m), or there
/// are too many points for a soft part.
Hull refined(const Hull& hull, double longest_edge);

/// A floating soft body with a hull as its surface, of the part's mass, centre of mass and inertia. Throws
/// DescriptionError where the hull makes too many points, or its inertia cannot be shared between points and
/// core.
dart::dynamics::SkeletonPtr make_soft_part(const std::string& name, const PartDescription& part,
                                           const Hull& hull, double time_step);

/// The surface of a soft part.
dart::dynamics::ShapeNode* soft_surface(dart::dynamics::BodyNode* body);

/// The points of a body; of a rigid one there are none.
std::vector<SoftPoint> soft_points(const dart::dynamics::BodyNode* body);
/// As many as the body has.
void restore_soft_points(dart::dynamics::BodyNode* body, const std::vector<SoftPoint>& points);

}  // namespace robotcell
