// The forces along the stroke of two opposed fingers, as a constraint of the dynamics engine.
#pragma once

#include <array>
#include <dart/constraint/ConstraintBase.hpp>
#include <dart/dynamics/BodyNode.hpp>

namespace robotcell {

/// What the drive of one finger tries to do within a step.
struct FingerDrive {
  double speed = 0;  // m/s, opening
  double force = 0;  // N, the most that it gives either way
};

/// Each finger has a drive that keeps a speed as far as its force allows; pressed against something it gives
/// all of that force. A third force, of a damped spring, pulls both fingers to equal distances from the
/// middle without changing what they squeeze with. All three are solved together with the contacts, so that
/// stiff springs and firm grasps stay stable at any time step.
class FingerDrives : public dart::constraint::ConstraintBase {
 public:
  FingerDrives(std::array<dart::dynamics::BodyNode*, 2> fingers, double centring_stiffness, double time_step);

  void set(const std::array<FingerDrive, 2>& drives) { drives_ = drives; }

  /// Force of each drive in the last step (N, opening), and the centring force on the first finger.
  const std::array<double, 3>& forces() const { return forces_; }

  void update() override {}
  void getInformation(dart::constraint::ConstraintInfo* info) override;
  void applyUnitImpulse(std::size_t index) override;
  void getVelocityChange(double* vel, bool withCfm) override;
  void excite() override;
  void unexcite() override;
  void applyImpulse(double* lambda) override;
  bool isActive() const override { return true; }
  dart::dynamics::SkeletonPtr getRootSkeleton() const override;

 private:
  dart::dynamics::Joint* joint(std::size_t finger) const { return fingers_[finger]->getParentJoint(); }

  std::array<dart::dynamics::BodyNode*, 2> fingers_;
  std::array<FingerDrive, 2> drives_{};
  std::array<double, 3> forces_{};
  double stiffness_, damping_, time_step_;
  std::size_t excited_ = 0;
};

}  // namespace robotcell
