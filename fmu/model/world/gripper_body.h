// Gripper in the dynamics world: two fingers on prismatic joints at the flange.
#pragma once

#include <array>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/ShapeNode.hpp>
#include <dart/simulation/World.hpp>
#include <memory>

#include "fmu/model/devices/gripper.h"
#include "fmu/model/world/finger_drives.h"

namespace robotcell {

class Gripper {
 public:
  Gripper(const GripperDescription& description, dart::dynamics::BodyNode* flange, double time_step);

  /// Adds the finger drives to the constraints of a world.
  void connect(const dart::simulation::WorldPtr& world);

  void command(const GripperCommand& command);

  /// Call before and after every step of the world.
  void begin_step();
  void end_step();

  double opening(std::size_t finger) const { return fingers_[finger]->getParentJoint()->getPosition(0); }
  double width() const { return opening(0) + opening(1); }

  /// Closing force of the drives (mean of both), N.
  double force() const { return drive_force_; }

  /// Whether the fingers press with the full force and stand still without being closed.
  bool is_gripping() const;

  dart::dynamics::BodyNode* finger(std::size_t i) const { return fingers_[i]; }
  dart::dynamics::ShapeNode* pad(std::size_t i) const { return fingers_[i]->getShapeNode(0); }

  GripperState state() const;
  void restore(const GripperState& state);

 private:
  double speed(std::size_t finger) const { return fingers_[finger]->getParentJoint()->getVelocity(0); }
  FingerDrive drive(std::size_t finger) const;
  double force_limit() const;

  GripperDescription description_;
  double time_step_;
  std::array<dart::dynamics::BodyNode*, 2> fingers_{};
  std::shared_ptr<FingerDrives> drives_;
  GripperCommand command_;
  double drive_force_ = 0;
};

}  // namespace robotcell
