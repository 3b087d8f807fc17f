#include "fmu/model/world/kinematics.h"

#include <cmath>

namespace robotcell {
namespace {

using Eigen::AngleAxisd;
using Eigen::Isometry3d;
using Eigen::Translation3d;
using Eigen::Vector3d;

Isometry3d rotation_about_z(double angle) { return Isometry3d(AngleAxisd(angle, Vector3d::UnitZ())); }

/// Fixed transform after joint i: Rz(theta) T(a, 0, d) Rx(alpha) Ry(beta).
Isometry3d fixed_part(const JointDescription& joint, const DhDeviation& delta) {
  return rotation_about_z(joint.theta + delta.theta) *
         Translation3d(joint.a + delta.a, 0, joint.d + delta.d) *
         AngleAxisd(joint.alpha + delta.alpha, Vector3d::UnitX()) *
         AngleAxisd(joint.beta + delta.beta, Vector3d::UnitY());
}

/// Motion of the link after a revolute joint about the z axis of `base`.
Motion after_joint(const Motion& base, double angle, double rate, const Isometry3d& joint_from_link) {
  Motion rotated = base;
  rotated.pose = base.pose * rotation_about_z(angle);
  rotated.angular_velocity += rate * base.pose.linear().col(2);
  return attached(rotated, joint_from_link);
}

template <std::size_t N>
std::array<double, N> numbers(const Eigen::Matrix<double, static_cast<int>(N), 1>& vector) {
  std::array<double, N> values;
  Eigen::Map<Eigen::Matrix<double, static_cast<int>(N), 1>>(values.data()) = vector;
  return values;
}

}  // namespace

Motion attached(const Motion& body, const Isometry3d& body_from_frame) {
  Motion frame;
  frame.pose = body.pose * body_from_frame;
  frame.angular_velocity = body.angular_velocity;
  frame.velocity =
      body.velocity + body.angular_velocity.cross(body.pose.linear() * body_from_frame.translation());
  return frame;
}

Kinematics::Kinematics(const CellDescription& cell, const AsBuilt& as_built)
    : world_from_base_(cell.world_from_base),
      wobble_(as_built.wobble),
      axis_from_platter_(Isometry3d::Identity()) {
  for (std::size_t i = 0; i < cell.joints.size(); ++i) {
    joint_from_link_.push_back(fixed_part(cell.joints[i], as_built.dh[i]));
  }
  const auto& tool = as_built.tool;
  flange_from_sensor_ = cell.flange_from_sensor * Translation3d(tool[0], tool[1], tool[2]) *
                        AngleAxisd(tool[3], Vector3d::UnitX()) * AngleAxisd(tool[4], Vector3d::UnitY()) *
                        AngleAxisd(tool[5], Vector3d::UnitZ());
  const auto& table = as_built.table;
  world_from_axis_ = cell.table.world_from_table * Translation3d(table[0], table[1], table[2]) *
                     AngleAxisd(table[3], Vector3d::UnitX()) * AngleAxisd(table[4], Vector3d::UnitY());
  axis_from_platter_.translation() << as_built.platter[0], as_built.platter[1], 0;
}

Motion Kinematics::base() const {
  Motion base;
  base.pose = world_from_base_;
  return base;
}

LinkMotions Kinematics::arm(const std::array<double, kAxes>& position, const std::array<double, kAxes>& rate,
                            const Motion& base) const {
  LinkMotions links;
  links.count = joints();
  for (std::size_t i = 0; i < joints(); ++i) {
    links[i] = after_joint(i == 0 ? base : links[i - 1], position[i], rate[i], joint_from_link_[i]);
  }
  return links;
}

Motion Kinematics::platter(double angle, double rate) const {
  const Vector3d direction(std::cos(wobble_.direction), std::sin(wobble_.direction), 0);
  const double tilt = wobble_.amplitude * std::cos(angle + wobble_.phase);
  const double tilt_rate = -wobble_.amplitude * std::sin(angle + wobble_.phase) * rate;
  Motion axis;
  axis.pose = world_from_axis_ * AngleAxisd(tilt, direction);
  axis.angular_velocity = tilt_rate * (world_from_axis_.linear() * direction);
  return after_joint(axis, angle, rate, axis_from_platter_);
}

BodyState body_state(const Motion& motion) {
  Eigen::Quaterniond rotation(motion.pose.linear());
  if (rotation.w() < 0) rotation.coeffs() *= -1;
  BodyState state;
  state.position = numbers<3>(motion.pose.translation());
  state.orientation = {rotation.w(), rotation.x(), rotation.y(), rotation.z()};
  state.velocity = numbers<3>(motion.velocity);
  state.angular_velocity = numbers<3>(motion.angular_velocity);
  return state;
}

}  // namespace robotcell
