#include "fmu/model/stick_anchor.h"

#include <cmath>

namespace robotcell {
namespace {

/// Share of the Coulomb limit up to which the body counts as held: the solver's own limit is approached from
/// below.
constexpr double kHeldShare = 0.98;

/// Angle by which `to` is turned about z against `from`.
double turn_about_z(const Eigen::Matrix3d& from, const Eigen::Matrix3d& to) {
  const Eigen::Matrix3d change = to * from.transpose();
  return std::atan2(change(1, 0) - change(0, 1), change(0, 0) + change(1, 1));
}

}  // namespace

Eigen::Isometry3d StickAnchor::settle(const Eigen::Isometry3d& support_from_body, const ContactForce& force) {
  const bool held = force.normal > 0 && force.tangential.norm() < kHeldShare * friction_ * force.normal;
  if (!held) {
    state_.engaged = false;
    return support_from_body;
  }
  if (!state_.engaged) {
    state_ = {true, support_from_body};
    return support_from_body;
  }
  const double turn = turn_about_z(state_.support_from_body.linear(), support_from_body.linear());
  Eigen::Isometry3d restored = support_from_body;
  restored.linear() = Eigen::AngleAxisd(-turn, Eigen::Vector3d::UnitZ()) * support_from_body.linear();
  restored.translation().head<2>() = state_.support_from_body.translation().head<2>();
  return restored;
}

}  // namespace robotcell
