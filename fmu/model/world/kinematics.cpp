#include "fmu/model/world/kinematics.h"

#include <cmath>

namespace robotcell {
namespace {

using Eigen::AngleAxisd;
using Eigen::Isometry3d;
using Eigen::Translation3d;
using Eigen::Vector3d;

/// Constant transform behind joint i: Rz(theta) T(a, 0, d) Rx(alpha) Ry(beta).
Isometry3d behind_joint(const JointDescription& joint, const DhDeviation& delta) {
  return Isometry3d(AngleAxisd(joint.theta + delta.theta, Vector3d::UnitZ())) *
         Translation3d(joint.a + delta.a, 0, joint.d + delta.d) *
         AngleAxisd(joint.alpha + delta.alpha, Vector3d::UnitX()) *
         AngleAxisd(joint.beta + delta.beta, Vector3d::UnitY());
}

Joint fixed(int parent, const Isometry3d& parent_from_frame) {
  return {Joint::Kind::kFixed, parent, -1, Isometry3d::Identity(), parent_from_frame};
}

Tree tree_of(const CellDescription& cell, const AsBuilt& as_built) {
  std::vector<Joint> joints{{Joint::Kind::kFixed, kWorld, -1, cell.world_from_base, Isometry3d::Identity()}};
  for (std::size_t i = 0; i < cell.joints.size(); ++i) {
    const int last = static_cast<int>(i);
    joints.push_back({Joint::Kind::kRevolute, last, last, Isometry3d::Identity(),
                      behind_joint(cell.joints[i], as_built.dh[i])});
  }
  const auto& tool = as_built.tool;
  const int last = static_cast<int>(cell.joints.size());
  joints.push_back(fixed(last, Isometry3d::Identity()));
  joints.push_back(fixed(last + 1, cell.flange_from_sensor * Translation3d(tool[0], tool[1], tool[2]) *
                                       AngleAxisd(tool[3], Vector3d::UnitX()) *
                                       AngleAxisd(tool[4], Vector3d::UnitY()) *
                                       AngleAxisd(tool[5], Vector3d::UnitZ())));
  const auto& table = as_built.table;
  joints.push_back({Joint::Kind::kFixed, kWorld, -1, cell.table.world_from_table, Isometry3d::Identity()});
  const Isometry3d table_from_axis = Translation3d(table[0], table[1], table[2]) *
                                     AngleAxisd(table[3], Vector3d::UnitX()) *
                                     AngleAxisd(table[4], Vector3d::UnitY());
  joints.push_back({Joint::Kind::kRevolute, last + 3, static_cast<int>(kTableAxis), table_from_axis,
                    Isometry3d(Translation3d(as_built.platter[0], as_built.platter[1], 0))});
  return Tree(joints);
}

template <std::size_t N>
std::array<double, N> numbers(const Eigen::Matrix<double, static_cast<int>(N), 1>& vector) {
  std::array<double, N> values;
  Eigen::Map<Eigen::Matrix<double, static_cast<int>(N), 1>>(values.data()) = vector;
  return values;
}

}  // namespace

Kinematics::Kinematics(const CellDescription& cell, const AsBuilt& as_built)
    : joints_(cell.joints.size()), wobble_(as_built.wobble), tree_(tree_of(cell, as_built)) {}

std::vector<Motion> Kinematics::frames(const std::array<double, kAxes>& position,
                                       const std::array<double, kAxes>& rate,
                                       const VibrationDisplacements& vibration) const {
  return tree_.motions(position.data(), rate.data(),
                       deviations(position[kTableAxis], rate[kTableAxis], vibration));
}

Motion Kinematics::frame(int frame, const std::array<double, kAxes>& position,
                         const std::array<double, kAxes>& rate,
                         const VibrationDisplacements& vibration) const {
  return tree_.frame(frame, position.data(), rate.data(),
                     deviations(position[kTableAxis], rate[kTableAxis], vibration));
}

std::vector<Deviation> Kinematics::deviations(double table, double table_rate,
                                              const VibrationDisplacements& vibration) const {
  std::vector<Deviation> found;
  const std::array<std::pair<int, const Displacement*>, 3> displaced{
      {{kBase, &vibration.base}, {flange(), &vibration.flange}, {this->table(), &vibration.table}}};
  for (const auto& [joint, by] : displaced) {
    if (by->position.isZero(0) && by->velocity.isZero(0)) continue;
    found.push_back({joint, {Isometry3d(Translation3d(by->position)), by->velocity, Vector3d::Zero()}});
  }
  if (wobble_.amplitude != 0) {
    const Vector3d direction(std::cos(wobble_.direction), std::sin(wobble_.direction), 0);
    const double tilt = wobble_.amplitude * std::cos(table + wobble_.phase);
    const double rate = -wobble_.amplitude * std::sin(table + wobble_.phase) * table_rate;
    found.push_back(
        {platter(), {Isometry3d(AngleAxisd(tilt, direction)), Vector3d::Zero(), rate * direction}});
  }
  return found;
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
