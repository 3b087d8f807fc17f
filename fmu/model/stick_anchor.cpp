#include "fmu/model/stick_anchor.h"

#include <cmath>

namespace robotcell {
namespace {

/// Share of the Coulomb limit up to which the body counts as held: the solver's own limit is approached from
/// below.
constexpr double kHeldShare = 0.995;

/// Angle by which `to` is turned about an axis against `from` (the twist of the change between them).
double turn_about(const Eigen::Vector3d& axis, const Eigen::Matrix3d& from, const Eigen::Matrix3d& to) {
  const Eigen::Quaterniond change(to * from.transpose());
  return 2 * std::atan2(change.vec().dot(axis), change.w());
}

}  // namespace

ContactForce split(const Eigen::Vector3d& force, const Eigen::Vector3d& normal) {
  const double along = force.dot(normal);
  return {along, force - along * normal};
}

bool friction_holds(const ContactForce& force, double friction) {
  return force.normal > 0 && force.tangential.norm() < kHeldShare * friction * force.normal;
}

Eigen::Isometry3d held_pose(const StickAnchor& anchor, const Eigen::Isometry3d& support_from_body) {
  const Eigen::Vector3d& n = anchor.normal;
  const double turn = turn_about(n, anchor.support_from_body.linear(), support_from_body.linear());
  const Eigen::Vector3d lift = support_from_body.translation() - anchor.support_from_body.translation();
  Eigen::Isometry3d held = support_from_body;
  held.linear() = Eigen::AngleAxisd(-turn, n) * support_from_body.linear();
  held.translation() = anchor.support_from_body.translation() + lift.dot(n) * n;
  return held;
}

}  // namespace robotcell
