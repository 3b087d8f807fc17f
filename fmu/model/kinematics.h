// Forward kinematics of the cell: poses and twists of all bodies from positions and rates of the axes.
#pragma once

#include <Eigen/Geometry>
#include <array>

#include "fmu/model/cell_description.h"
#include "fmu/model/cell_values.h"

namespace robotcell {

/// Pose and twist of a frame in the world (velocity of its origin).
struct Motion {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();
};

/// Motion of a frame that is fixed to a moving body.
Motion attached(const Motion& body, const Eigen::Isometry3d& body_from_frame);

/// Kinematics of arm and table: nominal geometry plus deviations.
class Kinematics {
 public:
  Kinematics(const CellDescription& cell, const AsBuilt& as_built);

  /// Motions of links 1 to 6; the frame of link i is the Denavit-Hartenberg frame after joint i.
  std::array<Motion, kJoints> arm(const std::array<double, kAxes>& position,
                                  const std::array<double, kAxes>& rate) const {
    return arm(position, rate, base());
  }
  /// The same on a moving base.
  std::array<Motion, kJoints> arm(const std::array<double, kAxes>& position,
                                  const std::array<double, kAxes>& rate, const Motion& base) const;

  /// Motion of the stationary base.
  Motion base() const;

  const Eigen::Isometry3d& flange_from_sensor() const { return flange_from_sensor_; }
  Motion sensor(const Motion& flange) const { return attached(flange, flange_from_sensor_); }

  /// Motion of the platter: the rotating frame at the platter's centre, with the axis tilted by the wobble.
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

/// Converts a motion to plain numbers.
BodyState body_state(const Motion& motion);

}  // namespace robotcell
