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

/// The frames of the tree in the order of their numbers.
Tree tree_of(const CellDescription& cell, const AsBuilt& as_built) {
  constexpr auto kFixed = Joint::Kind::kFixed, kRevolute = Joint::Kind::kRevolute;
  const Isometry3d here = Isometry3d::Identity();
  Tree tree;
  for (std::size_t i = 0; i < cell.axes.size(); ++i) {
    const AxisDescription& axis = cell.axes[i];
    const auto kind = axis.slides ? Joint::Kind::kPrismatic : kRevolute;
    // The deviation is that of the frame which the axis carries, at position 0.
    const Isometry3d at_0 = displaced(axis.parent_from_joint * axis.joint_from_frame, as_built.axes[i]);
    const Isometry3d parent_from_joint = at_0 * axis.joint_from_frame.inverse();
    tree.add({kind, axis.moves_with, kFirstFurtherAxis + i, parent_from_joint, axis.joint_from_frame});
  }
  std::size_t last = tree.add({kFixed, cell.robot_moves_with, 0, cell.world_from_base, here});
  for (std::size_t i = 0; i < cell.joints.size(); ++i) {
    last = tree.add({kRevolute, last, i, here, behind_joint(cell.joints[i], as_built.dh[i])});
  }
  const std::size_t flange = tree.add({kFixed, last, 0, here, here});
  const std::size_t carrier = cell.sensor_moves_with.value_or(flange);
  tree.add({kFixed, carrier, 0, here, displaced(cell.carrier_from_sensor, as_built.tool)});
  const auto& table = as_built.table;
  const Isometry3d table_from_axis = Translation3d(table[0], table[1], table[2]) *
                                     AngleAxisd(table[3], Vector3d::UnitX()) *
                                     AngleAxisd(table[4], Vector3d::UnitY());
  last = tree.add({kFixed, cell.table_moves_with, 0, cell.table.world_from_table, here});
  tree.add({kRevolute, last, kTableAxis, table_from_axis,
            Isometry3d(Translation3d(as_built.platter[0], as_built.platter[1], 0))});
  for (std::size_t i = 0; i < cell.further_sensors.size(); ++i) {
    const FurtherSensorDescription& sensor = cell.further_sensors[i];
    tree.add({kFixed, sensor.moves_with, 0, here,
              displaced(sensor.parent_from_sensor, as_built.further_sensors[i])});
  }
  for (const ConveyorDescription& conveyor : cell.conveyors) {
    tree.add({kFixed, kWorld, 0, conveyor.world_from_belt, here});
  }
  return tree;
}

template <std::size_t N>
std::array<double, N> numbers(const Eigen::Matrix<double, static_cast<int>(N), 1>& vector) {
  std::array<double, N> values;
  Eigen::Map<Eigen::Matrix<double, static_cast<int>(N), 1>>(values.data()) = vector;
  return values;
}

}  // namespace

Kinematics::Kinematics(const CellDescription& cell, const AsBuilt& as_built)
    : numbers_(layout_of(cell).frames()), wobble_(as_built.wobble), tree_(tree_of(cell, as_built)) {}

Isometry3d Kinematics::flange_from_tool() const {
  const Joint& sensor = tree_[numbers_.sensor()];
  return sensor.parent == numbers_.flange() ? sensor.joint_from_frame : Isometry3d::Identity();
}

std::vector<Motion> Kinematics::motions(const std::array<double, kAxes>& position,
                                        const std::array<double, kAxes>& rate,
                                        const VibrationDisplacements& vibration) const {
  return tree_.motions(position.data(), rate.data(),
                       deviations(position[kTableAxis], rate[kTableAxis], vibration));
}

Motion Kinematics::frame(std::size_t frame, const std::array<double, kAxes>& position,
                         const std::array<double, kAxes>& rate,
                         const VibrationDisplacements& vibration) const {
  return tree_.frame(frame, position.data(), rate.data(),
                     deviations(position[kTableAxis], rate[kTableAxis], vibration));
}

std::vector<Deviation> Kinematics::deviations(double table, double table_rate,
                                              const VibrationDisplacements& vibration) const {
  std::vector<Deviation> found;
  const std::array<std::pair<std::size_t, const Displacement*>, 3> displaced{
      {{numbers_.base(), &vibration.base},
       {numbers_.flange(), &vibration.flange},
       {numbers_.table(), &vibration.table}}};
  for (const auto& [joint, by] : displaced) {
    if (by->position.isZero(0) && by->velocity.isZero(0)) continue;
    found.push_back({joint, {Isometry3d(Translation3d(by->position)), by->velocity, Vector3d::Zero()}});
  }
  if (wobble_.amplitude != 0) {
    const Vector3d direction(std::cos(wobble_.direction), std::sin(wobble_.direction), 0);
    const double tilt = wobble_.amplitude * std::cos(table + wobble_.phase);
    const double rate = -wobble_.amplitude * std::sin(table + wobble_.phase) * table_rate;
    found.push_back(
        {numbers_.platter(), {Isometry3d(AngleAxisd(tilt, direction)), Vector3d::Zero(), rate * direction}});
  }
  return found;
}

Isometry3d displaced(const Isometry3d& frame, const std::array<double, 6>& by) {
  return frame * Translation3d(by[0], by[1], by[2]) * AngleAxisd(by[3], Vector3d::UnitX()) *
         AngleAxisd(by[4], Vector3d::UnitY()) * AngleAxisd(by[5], Vector3d::UnitZ());
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
