#include "fmu/model/world/finger_drives.h"

#include <cmath>
#include <dart/dynamics/Joint.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <limits>

namespace robotcell {
namespace {

constexpr std::size_t kCentring = 2;
constexpr std::size_t kRows = 3;

/// Constraint force mixing relative to the diagonal, to keep the system regular.
constexpr double kConstraintForceMixing = 1e-9;

/// Jacobian of the constraint: effect of a row's impulse on a finger, and of the finger's speed on the row.
double direction(std::size_t row, std::size_t finger) {
  if (row < kCentring) return row == finger ? 1 : 0;
  return finger == 0 ? 1 : -1;
}

}  // namespace

FingerDrives::FingerDrives(std::array<dart::dynamics::BodyNode*, 2> fingers, double centring_stiffness,
                           double time_step)
    : fingers_(fingers),
      stiffness_(centring_stiffness),
      // Critical damping: the difference of the finger positions has half a finger's mass.
      damping_(2 * std::sqrt(centring_stiffness * fingers[0]->getMass() / 2)),
      time_step_(time_step) {
  mDim = kRows;
}

/// A spring-damper as a soft constraint: Open Dynamics Engine manual, section 3.8 (error reduction and
/// constraint force mixing).
void FingerDrives::getInformation(dart::constraint::ConstraintInfo* info) {
  const double first = joint(0)->getVelocity(0);
  const double second = joint(1)->getVelocity(0);
  const double shift = joint(0)->getPosition(0) - joint(1)->getPosition(0);
  const double spring = -stiffness_ * shift / (time_step_ * stiffness_ + damping_);
  const std::array<double, kRows> wanted{drives_[0].speed - first, drives_[1].speed - second,
                                         spring - (first - second)};
  for (std::size_t row = 0; row < kRows; ++row) {
    info->x[row] = 0;
    info->b[row] = wanted[row];
    info->hi[row] =
        row < kCentring ? drives_[row].force * time_step_ : std::numeric_limits<double>::infinity();
    info->lo[row] = -info->hi[row];
  }
}

void FingerDrives::applyUnitImpulse(std::size_t index) {
  const auto skeleton = fingers_[0]->getSkeleton();
  skeleton->clearConstraintImpulses();
  for (std::size_t finger = 0; finger < 2; ++finger) {
    joint(finger)->setConstraintImpulse(0, direction(index, finger));
  }
  for (dart::dynamics::BodyNode* finger : fingers_) skeleton->updateBiasImpulse(finger);
  skeleton->updateVelocityChange();
  for (std::size_t finger = 0; finger < 2; ++finger) joint(finger)->setConstraintImpulse(0, 0);
  excited_ = index;
}

void FingerDrives::getVelocityChange(double* vel, bool withCfm) {
  for (std::size_t row = 0; row < kRows; ++row) {
    vel[row] = 0;
    if (!fingers_[0]->getSkeleton()->isImpulseApplied()) continue;
    for (std::size_t finger = 0; finger < 2; ++finger) {
      vel[row] += direction(row, finger) * joint(finger)->getVelocityChange(0);
    }
  }
  if (!withCfm) return;
  vel[excited_] *= 1 + kConstraintForceMixing;
  if (excited_ == kCentring) vel[kCentring] += 1 / (time_step_ * (time_step_ * stiffness_ + damping_));
}

void FingerDrives::excite() { fingers_[0]->getSkeleton()->setImpulseApplied(true); }

void FingerDrives::unexcite() { fingers_[0]->getSkeleton()->setImpulseApplied(false); }

void FingerDrives::applyImpulse(double* lambda) {
  for (std::size_t row = 0; row < kRows; ++row) {
    forces_[row] = lambda[row] / time_step_;
    for (std::size_t finger = 0; finger < 2; ++finger) {
      const double impulse = joint(finger)->getConstraintImpulse(0) + direction(row, finger) * lambda[row];
      joint(finger)->setConstraintImpulse(0, impulse);
    }
  }
}

dart::dynamics::SkeletonPtr FingerDrives::getRootSkeleton() const {
  return ConstraintBase::getRootSkeleton(fingers_[0]->getSkeleton());
}

}  // namespace robotcell
