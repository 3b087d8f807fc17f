// Bodies of the cell as skeletons of the dynamics engine. Names must be unique within a world.
#pragma once

#include <dart/dynamics/Skeleton.hpp>

#include "fmu/model/description/cell_description.h"
#include "fmu/model/world/kinematics.h"

namespace robotcell {

/// Joints take prescribed positions, or prescribed velocities where the arm is mobile (carries a gripper).
/// Where an axis carries the arm, its first body is the base, on a free joint with prescribed velocities.
dart::dynamics::SkeletonPtr make_arm(const Kinematics& kinematics, bool mobile);

/// The platter; its free joint is prescribed, so that it can follow any error motion of the axis.
dart::dynamics::SkeletonPtr make_table(const TableDescription& table, bool collides);

/// The body of a belt does not move; a prismatic joint along x gives its surface a velocity.
dart::dynamics::SkeletonPtr make_belt(const std::string& name, const ConveyorDescription& conveyor);

/// Body of what a further axis carries itself, on a free joint that is prescribed.
dart::dynamics::SkeletonPtr make_carriage(const std::string& name);

/// The stationary environment.
dart::dynamics::SkeletonPtr make_ground();

dart::dynamics::SkeletonPtr make_free_part(const std::string& name, const PartDescription& part,
                                           double time_step);

/// Adds the hull of a part to a body as a collision shape.
dart::dynamics::ShapeNode* add_hull(dart::dynamics::BodyNode* body, const Eigen::Isometry3d& body_from_part,
                                    const PartDescription& part);

/// Adds a hull, given in a frame of the body, as a contact shape; `prescribed`: the body does not move by
/// forces.
dart::dynamics::ShapeNode* add_contact_shape(dart::dynamics::BodyNode* body,
                                             const Eigen::Isometry3d& body_from_frame, const Hull& hull,
                                             double friction, bool prescribed);

}  // namespace robotcell
