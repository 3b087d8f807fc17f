// The bodies of the cell as skeletons of the dynamics engine. Names must differ within a world.
#pragma once

#include <dart/dynamics/Skeleton.hpp>

#include "fmu/model/cell_description.h"
#include "fmu/model/kinematics.h"

namespace robotcell {

/// The joints take imposed positions, or imposed velocities where the arm carries what moves by itself.
dart::dynamics::SkeletonPtr make_arm(const Kinematics& kinematics, bool carries);

/// The platter; its floating joint is imposed, so that any error motion of the axis can be.
dart::dynamics::SkeletonPtr make_table(const TableDescription& table, bool collides);

/// A belt stands still, and a prismatic joint along x gives its surface a speed.
dart::dynamics::SkeletonPtr make_belt(const std::string& name, const ConveyorDescription& conveyor);

/// What stands in the world and never moves.
dart::dynamics::SkeletonPtr make_ground();

dart::dynamics::SkeletonPtr make_free_part(const std::string& name, const PartDescription& part,
                                           double time_step);

/// Adds a part's hull to a body.
dart::dynamics::ShapeNode* add_hull(dart::dynamics::BodyNode* body, const Eigen::Isometry3d& body_from_part,
                                    const PartDescription& part);

}  // namespace robotcell
