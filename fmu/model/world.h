// The dynamics world of the cell: arm, table and part as bodies of DART.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <memory>

#include "fmu/model/cell_description.h"
#include "fmu/model/kinematics.h"
#include "fmu/model/stick_anchor.h"

namespace robotcell {

/// Positions and rates of all axes at one instant (rad, rad/s).
struct AxesState {
  std::array<double, kAxes> position{};
  std::array<double, kAxes> rate{};
};

/// All that the world remembers of a free part between two steps.
struct FreePartState {
  std::array<double, 6> position{};  // of the floating joint
  std::array<double, 6> velocity{};
  std::array<double, 3> friction_direction{};  // world; along the friction force of the last step
  StickAnchorState anchor;
};

/// Arm and table are driven kinematically: ideal drives impose positions at the grid of the time step, and
/// contacts see the velocities that belong to them. A clamped part is rigid to the platter; a free one moves
/// by gravity, contact and friction.
class World {
 public:
  World(const CellDescription& cell, const Kinematics& kinematics, const AxesState& start);
  ~World();
  World(const World&) = delete;
  World& operator=(const World&) = delete;

  /// Advances by one time step while the axes move from one state to another.
  void step(const AxesState& from, const AxesState& to);

  /// Pose of the part in the platter's frame; exactly constant for a clamped part.
  Eigen::Isometry3d platter_from_part() const;

  /// Pose of a body of the arm as the dynamics engine has it, link 0..5.
  Eigen::Isometry3d link_pose(int link) const;

  FreePartState free_part() const;
  void restore(const AxesState& axes, const FreePartState& part);

 private:
  struct Bodies;
  void set_axes(const AxesState& axes);
  void settle(const AxesState& axes);
  void orient_friction();
  void read_contact();

  double time_step_;
  bool free_;
  Eigen::Isometry3d clamped_pose_;
  Eigen::Vector3d friction_direction_ = Eigen::Vector3d::Zero();
  StickAnchor anchor_;
  std::unique_ptr<Bodies> bodies_;
};

}  // namespace robotcell
