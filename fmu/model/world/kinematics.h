// Forward kinematics of the cell: poses and twists of all bodies from positions and rates of the axes.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <vector>

#include "fmu/model/as_built.h"
#include "fmu/model/bodies.h"
#include "fmu/model/description/cell_description.h"

namespace robotcell {

/// Pose and twist of a frame in the world (velocity of its origin).
struct Motion {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();
};

/// Motions of the links of an arm; only the first `count` places are used.
struct LinkMotions {
  std::array<Motion, kMaxJoints> motions;
  std::size_t count = 0;

  Motion& operator[](std::size_t i) { return motions[i]; }
  const Motion& operator[](std::size_t i) const { return motions[i]; }
  Motion& back() { return motions[count - 1]; }
  const Motion& back() const { return motions[count - 1]; }
};

/// Motion of a frame that is fixed to a moving body.
Motion attached(const Motion& body, const Eigen::Isometry3d& body_from_frame);

/// Kinematics of arm and table: nominal geometry plus deviations.
class Kinematics {
 public:
  Kinematics(const CellDescription& cell, const AsBuilt& as_built);

  std::size_t joints() const { return joint_from_link_.size(); }

  /// Motions of the links; the frame of link i is the Denavit-Hartenberg frame after joint i.
  LinkMotions arm(const std::array<double, kAxes>& position, const std::array<double, kAxes>& rate) const {
    return arm(position, rate, base());
  }
  /// The same on a moving base.
  LinkMotions arm(const std::array<double, kAxes>& position, const std::array<double, kAxes>& rate,
                  const Motion& base) const;

  /// Motion of the stationary base.
  Motion base() const;

  const Eigen::Isometry3d& flange_from_sensor() const { return flange_from_sensor_; }
  Motion sensor(const Motion& flange) const { return attached(flange, flange_from_sensor_); }

  /// Motion of the platter: the rotating frame at the platter's centre, with the axis tilted by the wobble.
  Motion platter(double angle, double rate) const;

  const Eigen::Isometry3d& world_from_base() const { return world_from_base_; }
  const Eigen::Isometry3d& joint_from_link(std::size_t i) const { return joint_from_link_[i]; }

 private:
  Eigen::Isometry3d world_from_base_;
  std::vector<Eigen::Isometry3d> joint_from_link_;
  Eigen::Isometry3d flange_from_sensor_;
  Eigen::Isometry3d world_from_axis_;
  TableWobble wobble_;
  Eigen::Isometry3d axis_from_platter_;
};

/// Converts a motion to plain numbers.
BodyState body_state(const Motion& motion);

}  // namespace robotcell
