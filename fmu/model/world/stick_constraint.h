// Position-level correction of static friction. All of it is in stick_constraint.cpp; the world calls the two
// functions that world_engine.h declares, and stores the state.
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

/// Friction load of a contact patch, relative to its limits.
struct PatchLoad {
  double force = 0;    // tangential force over mu N
  double torsion = 0;  // moment about the normal at the centre of pressure, over mu sum(N_i r_i)
};

/// Whether friction holds a patch: the load is within the ellipse that approximates the limit surface of
/// force and torsion (Howe and Cutkosky, Practical force-motion models for sliding manipulation, 1996). Exact
/// for a force alone and for a torsion alone.
bool friction_holds(const PatchLoad& load);

/// Stick constraint of a part on a support.
///
/// A velocity-level friction solver lets a sticking body creep on a rotating table. While friction holds, the
/// pose is projected back in the contact plane (two translations, and the rotation about the normal) to where
/// the body came to rest on its support; height and tilt follow the dynamics. The constraint is released at
/// the limit of friction and engaged again where the body comes to rest. Of several supports on which a body
/// sticks, that acts which the body came to rest on first; when it is released, the one with the largest
/// normal force takes over from the pose at that instant.
struct StickConstraint {
  std::int32_t support = -1;                                            // number in the world; -1: none
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();                    // contact normal, support frame
  Eigen::Isometry3d support_from_body = Eigen::Isometry3d::Identity();  // when the constraint was engaged
};

/// Projection of a pose onto the constraint.
Eigen::Isometry3d project_pose(const StickConstraint& constraint, const Eigen::Isometry3d& support_from_body);

/// Stick constraint of a part, and what it needs from the present step.
struct StickState {
  StickConstraint constraint;
  /// Pose relative to the support, and Jacobian of the support's body (empty where that is a free part), at
  /// the start of the step.
  Eigen::Isometry3d support_from_part = Eigen::Isometry3d::Identity();
  Eigen::Matrix<double, 6, Eigen::Dynamic> support_jacobian;
  Eigen::Isometry3d before = Eigen::Isometry3d::Identity();  // pose at the start of the step
  /// Integrated by the engine in the step: twist times time step.
  Eigen::Matrix<double, 6, 1> displacement = Eigen::Matrix<double, 6, 1>::Zero();
  bool updated = false;  // already applied in this step
};

}  // namespace robotcell
