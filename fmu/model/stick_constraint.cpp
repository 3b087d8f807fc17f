#include "fmu/model/stick_constraint.h"

#include <cmath>

namespace robotcell {
namespace {

/// Fraction of the friction limit up to which a body sticks: the solver approaches its limit from below.
constexpr double kFrictionConeMargin = 0.995;

/// Rotation angle about an axis from `from` to `to` (swing-twist decomposition).
double twist_angle(const Eigen::Vector3d& axis, const Eigen::Matrix3d& from, const Eigen::Matrix3d& to) {
  const Eigen::Quaterniond change(to * from.transpose());
  return 2 * std::atan2(change.vec().dot(axis), change.w());
}

}  // namespace

ContactForce split(const Eigen::Vector3d& force, const Eigen::Vector3d& normal) {
  const double along = force.dot(normal);
  return {along, force - along * normal};
}

bool within_friction_cone(const ContactForce& force, double friction) {
  return force.normal > 0 && force.tangential.norm() < kFrictionConeMargin * friction * force.normal;
}

Eigen::Isometry3d project_pose(const StickConstraint& constraint,
                               const Eigen::Isometry3d& support_from_body) {
  const Eigen::Vector3d& n = constraint.normal;
  const double twist = twist_angle(n, constraint.support_from_body.linear(), support_from_body.linear());
  const Eigen::Vector3d lift = support_from_body.translation() - constraint.support_from_body.translation();
  Eigen::Isometry3d projected = support_from_body;
  projected.linear() = Eigen::AngleAxisd(-twist, n) * support_from_body.linear();
  projected.translation() = constraint.support_from_body.translation() + lift.dot(n) * n;
  return projected;
}

}  // namespace robotcell
