// Exact forward kinematics of the cell: poses and twists of every body from the axes' positions and rates.
#pragma once

#include <Eigen/Geometry>
#include <array>

#include "fmu/model/cell_description.h"
#include "fmu/model/cell_values.h"

namespace robotcell {

/// Where a frame is in the world and how it moves (velocity of its origin).
struct Motion {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();
};

/// Motion of a frame fixed to a moving body.
Motion attached(const Motion& body, const Eigen::Isometry3d& body_from_frame);

/// The frame of reference and the geometry between the axes, nominal plus deviations.
class Kinematics {
 public:
  Kinematics(const CellDescription& cell, const AsBuilt& as_built);

  /// Motions of links 1..6; link i's frame is the Denavit-Hartenberg frame behind joint i.
  std::array<Motion, kJoints> arm(const std::array<double, kAxes>& position,
                                  const std::array<double, kAxes>& rate) const {
    return arm(position, rate, base());
  }
  /// The same on a base that moves.
  std::array<Motion, kJoints> arm(const std::array<double, kAxes>& position,
                                  const std::array<double, kAxes>& rate, const Motion& base) const;

  /// The base as it stands.
  Motion base() const;

  Motion sensor(const Motion& flange) const { return attached(flange, flange_from_sensor_); }

  /// Motion of the platter: the turning frame, at the platter's own centre, its axis tilted by the wobble.
  Motion platter(double angle, double rate) const;

  const Eigen::Isometry3d& world_from_base() const { return world_from_base_; }
  const Eigen::Isometry3d& joint_from_link(int i) const {
    return joint_from_link_[static_cast<std::size_t>(i)];
  }

 private:
  Eigen::Isometry3d world_from_base_;
  std::array<Eigen::Isometry3d, kJoints> joint_from_link_;
  Eigen::Isometry3d flange_from_sensor_;
  Eigen::Isometry3d world_from_axis_;
  TableWobble wobble_;
  Eigen::Isometry3d axis_from_platter_;
};

/// The plain numbers that the cell reports for a motion.
BodyState body_state(const Motion& motion);

}  // namespace robotcell
