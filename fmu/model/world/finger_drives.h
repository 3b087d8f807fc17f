// Drive forces of two opposed fingers, as a constraint of the dynamics engine.
#pragma once

#include <array>
#include <dart/constraint/ConstraintBase.hpp>
#include <dart/dynamics/BodyNode.hpp>

namespace robotcell {

/// Command of the drive of one finger in a step.
struct FingerDrive {
  double speed = 0;  // m/s, positive: opening
  double force = 0;  // N, force limit in both directions
};

/// Each finger has a velocity drive with a force limit; pressed against a part it gives the full force. A
/// damped centring spring pulls both fingers to equal distances from the middle without changing the grip
/// force. All three forces are solved together with the contacts, so stiff springs and firm grasps are stable
/// at any time step.
class FingerDrives : public dart::constraint::ConstraintBase {
 public:
  FingerDrives(std::array<dart::dynamics::BodyNode*, 2> fingers, double centring_stiffness, double time_step);

  void set(const std::array<FingerDrive, 2>& drives) { drives_ = drives; }

  /// Force of each drive in the last step (N, positive: opening), and the centring force on the first finger.
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
