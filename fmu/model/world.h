// The dynamics world of the cell: arm, table, belts and parts as bodies of DART.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <memory>
#include <vector>

#include "fmu/control/belt_drive.h"
#include "fmu/model/axes_state.h"
#include "fmu/model/cell_description.h"
#include "fmu/model/gripper_state.h"
#include "fmu/model/kinematics.h"
#include "fmu/model/soft_point.h"
#include "fmu/model/stick_anchor.h"

namespace robotcell {

/// The motions that drives impose on the world, at one instant.
struct Imposed {
  AxesState axes;
  std::vector<control::BeltState> belts;
};

/// What a part moves with, whether it lies on that or on other parts that do.
enum class Carrier : std::int32_t { kWorld, kPlatter, kFlange };
constexpr std::size_t kCarriers = 3;

/// Where a part is, in the frame of what carries it.
struct PartPlace {
  Carrier carrier = Carrier::kWorld;
  Eigen::Isometry3d carrier_from_part = Eigen::Isometry3d::Identity();
};

/// All that the world remembers of a free part between two steps.
struct FreePartState {
  std::array<double, 6> position{};  // of the floating joint
  std::array<double, 6> velocity{};
  std::int32_t carrier = -1;  // support with the greatest contact force; -1: none
  std::vector<StickAnchor> anchors;
  std::vector<SoftPoint> points;  // of a soft part
};

/// A gripper's state, and what the parts in it feel: without a gripper nothing asks how fast the arm was.
struct GraspState {
  GripperState gripper;
  std::array<double, kJoints> arm_speed{};  // in the last step
};

/// Table and belts are driven kinematically, and so is the arm by default: positions are imposed at the grid
/// of the time step, and contacts see the velocities that belong to them. An arm with dynamic drives has
/// masses instead, and its motors follow what is imposed as well as they can. A belt's body stands still, its
/// surface moves. A clamped part is rigid to what it stands on; a free one moves by gravity, contact and
/// friction.
class World {
 public:
  World(const CellDescription& cell, const Kinematics& kinematics, const Imposed& start);
  ~World();
  World(const World&) = delete;
  World& operator=(const World&) = delete;

  /// Tells the gripper what to do from now on; of no effect in a cell without one.
  void command_gripper(const GripperCommand& command);

  /// Advances by one time step while the drives move from one state to another.
  void step(const Imposed& from, const Imposed& to);

  /// Place of a part; exactly constant for a clamped one.
  PartPlace place(std::size_t part) const;

  /// What an arm with dynamic drives does; nothing of meaning where they are kinematic.
  ArmDynamicsState arm() const;

  /// Pose of a body of the arm as the dynamics engine has it, link 0..5.
  Eigen::Isometry3d link_pose(int link) const;

  /// Nothing in a cell without a gripper.
  GripperPoint gripper() const;
  GraspState grasp() const;

  /// One state for each part; that of a clamped part holds nothing.
  std::vector<FreePartState> free_parts() const;
  /// Throws std::invalid_argument when the states are not of this cell.
  void restore(const Imposed& imposed, const ArmDynamicsState& arm, const std::vector<FreePartState>& parts,
               const GraspState& grasp);

 private:
  struct Engine;

  void add_supports(const CellDescription& cell);
  void add_dynamics(const CellDescription& cell, const Imposed& start);
  void add_gripper(const GripperDescription& description);
  void add_parts(const CellDescription& cell);
  void settle(const CellDescription& cell, const Imposed& start);
  void impose(const Imposed& imposed);
  void impose_speeds(const Imposed& from, const Imposed& to);

  double time_step_;
  Kinematics kinematics_;
  std::unique_ptr<Engine> engine_;
};

}  // namespace robotcell
