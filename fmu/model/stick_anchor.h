// Keeps a resting part where it is on its moving support.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>

namespace robotcell {

/// Contact force of a support on a part, split at the contact's plane (N).
struct ContactForce {
  double normal = 0;
  Eigen::Vector3d tangential = Eigen::Vector3d::Zero();  // world
};

ContactForce split(const Eigen::Vector3d& force, const Eigen::Vector3d& normal);

/// Whether friction holds, the force being below Coulomb's limit.
bool friction_holds(const ContactForce& force, double friction);

/// A velocity-level friction solver lets a body on a turning table creep outwards a little every step,
/// although friction holds it. While the friction used stays below the Coulomb limit, the anchor puts the
/// body's pose in the plane of contact (two shifts, and the turn about the normal) back to where it was when
/// it came to rest on its support; height and tilt stay with the dynamics. At the limit it lets go, and takes
/// hold again where the body comes to rest.
///
/// A body has one anchor for each support that holds it.
struct StickAnchor {
  std::int32_t support = 0;                           // number of the support in the world
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // of the plane of contact, support frame
  Eigen::Isometry3d support_from_body = Eigen::Isometry3d::Identity();  // when the body came to rest
};

/// The pose that an anchored body takes after a step.
Eigen::Isometry3d held_pose(const StickAnchor& anchor, const Eigen::Isometry3d& support_from_body);

}  // namespace robotcell
