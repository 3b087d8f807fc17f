#include "fmu/model/finger_drives.h"

#include <cmath>
#include <dart/dynamics/Joint.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <limits>

namespace robotcell {
namespace {

constexpr std::size_t kCentring = 2;
constexpr std::size_t kRows = 3;

/// Share of every row by which its own impulse yields, to keep the system of equations regular.
constexpr double kYield = 1e-9;

/// How an impulse of a row acts on a finger, and a finger's speed counts in the row.
double direction(std::size_t row, std::size_t finger) {
  if (row < kCentring) return row == finger ? 1 : 0;
  return finger == 0 ? 1 : -1;
}

}  // namespace

FingerDrives::FingerDrives(std::array<dart::dynamics::BodyNode*, 2> fingers, double centring_stiffness,
                           double time_step)
    : fingers_(fingers),
      stiffness_(centring_stiffness),
      // Critical for the bare fingers: the difference of their positions swings with half a finger's mass.
      damping_(2 * std::sqrt(centring_stiffness * fingers[0]->getMass() / 2)),
      time_step_(time_step) {
  mDim = kRows;
}

/// A spring with damping as a constraint that yields: see the Open Dynamics Engine's manual, section 3.8
/// (error reduction and constraint force mixing).
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
  vel[excited_] *= 1 + kYield;
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
