// Dynamics world of the cell: arm, table, belts, gripper and parts as bodies of DART.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <memory>
#include <string>
#include <vector>

#include "fmu/model/axes_state.h"
#include "fmu/model/description/cell_description.h"
#include "fmu/model/devices/belt.h"
#include "fmu/model/devices/gripper.h"
#include "fmu/model/world/kinematics.h"
#include "fmu/model/world/soft_point.h"
#include "fmu/model/world/stick_constraint.h"

namespace robotcell {

/// Prescribed motion of drives and belts at one instant.
struct PrescribedMotion {
  AxesState axes;
  std::vector<BeltState> belts;
};

/// Pose of a part relative to the frame of the tree with which it moves.
struct PartPlacement {
  std::size_t frame = kWorld;
  Eigen::Isometry3d frame_from_part = Eigen::Isometry3d::Identity();
};

/// State of a free part between two steps.
struct FreePartState {
  std::array<double, 6> position{};  // of the free joint
  std::array<double, 6> velocity{};
  std::int32_t main_support = -1;  // support with the largest normal force; -1: none
  StickConstraint stick_constraint;
  std::vector<SoftPoint> points;  // surface points of a soft part
};

/// State of the gripper, and of the arm that carries it. Unused without a gripper.
struct GraspState {
  GripperState gripper;
  std::array<double, kMaxJoints> arm_speed{};  // joint rates in the last step
};

/// State of all bodies that are not prescribed.
struct WorldState {
  ArmDynamicsState arm;              // default values with kinematic drives
  std::vector<FreePartState> parts;  // one for each part; empty for clamped parts
  GraspState grasp;
};

/// Table and belts are kinematic, and so is the arm by default: positions are prescribed at the points of the
/// time grid, and contacts use the corresponding velocities. An arm with dynamic drives has masses, and its
/// motors follow the prescribed positions. The body of a belt does not move, only its surface. A clamped part
/// is fixed to its support; a free part moves by gravity, contact and friction.
class World {
 public:
  struct Engine;  // world_engine.h

  World(const CellDescription& cell, const Kinematics& kinematics, const PrescribedMotion& start);
  ~World();
  World(const World&) = delete;
  World& operator=(const World&) = delete;

  /// Sets the command of the gripper; ignored in a cell without one.
  void command_gripper(const GripperCommand& command);

  /// Advances by one time step with the drives moving from one state to the other.
  void step(const PrescribedMotion& from, const PrescribedMotion& to);

  /// Exactly constant for a clamped part.
  PartPlacement placement(std::size_t part) const;

  /// State of an arm with dynamic drives; default values with kinematic drives.
  ArmDynamicsState arm() const;

  /// Pose of a link of the arm, counted from 0, in the dynamics engine.
  Eigen::Isometry3d link_pose(std::size_t link) const;

  /// Number of contact problems since the construction for which Dantzig's method failed or the sweeps on the
  /// friction cone did not converge, or steps whose joint friction did not, so that forces were approximate.
  std::int32_t solver_fallbacks() const;

  /// Number of times since the construction that a pair of bodies had more contact points than the collision
  /// detector can find, so that the kept ones were chosen among a part of them.
  std::int32_t truncated_contacts() const;

  /// Default values in a cell without gripper.
  GripperPoint gripper() const;

  /// Pairs of bodies that intersect at the start and therefore do not touch each other, as text; empty: none.
  const std::string& intersecting_bodies() const { return intersecting_bodies_; }

  WorldState state() const;
  /// Throws std::invalid_argument where the state belongs to another cell.
  void restore(const PrescribedMotion& prescribed, const WorldState& world);

 private:
  GraspState grasp() const;
  std::vector<FreePartState> free_parts() const;
  void add_supports(const CellDescription& cell);
  void add_dynamics(const CellDescription& cell);
  void add_gripper(const GripperDescription& description);
  void add_contact_bodies(const CellDescription& cell);
  void add_parts(const CellDescription& cell);
  void build(const CellDescription& cell, const PrescribedMotion& start);
  void settle(const CellDescription& cell, const PrescribedMotion& start);
  void prescribe(const PrescribedMotion& prescribed);
  void prescribe_velocities(const PrescribedMotion& from, const PrescribedMotion& to);

  double time_step_;
  Kinematics kinematics_;
  std::string intersecting_bodies_;
  std::unique_ptr<Engine> engine_;
};

}  // namespace robotcell
