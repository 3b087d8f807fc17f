// Position-level correction of static friction.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>

namespace robotcell {

/// Contact force of a support on a part, split into normal and tangential components (N).
struct ContactForce {
  double normal = 0;
  Eigen::Vector3d tangential = Eigen::Vector3d::Zero();  // world
};

ContactForce split(const Eigen::Vector3d& force, const Eigen::Vector3d& normal);

/// Whether the force is within Coulomb's friction cone.
bool within_friction_cone(const ContactForce& force, double friction);

/// Stick constraint of a part on one support.
///
/// A velocity-level friction solver lets a sticking body creep on a rotating table. While the friction force
/// stays within the cone, the pose is projected back in the contact plane (two translations, and the rotation
/// about the normal) to where the body came to rest on its support; height and tilt follow the dynamics. The
/// constraint is released at the limit of the cone and engaged again where the body comes to rest. A body has
/// one constraint for each support on which it sticks.
struct StickConstraint {
  std::int32_t support = 0;                                             // number of the support in the world
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();                    // contact normal, support frame
  Eigen::Isometry3d support_from_body = Eigen::Isometry3d::Identity();  // when the constraint was engaged
};

/// Projection of a pose onto the constraint.
Eigen::Isometry3d project_pose(const StickConstraint& constraint, const Eigen::Isometry3d& support_from_body);

}  // namespace robotcell
