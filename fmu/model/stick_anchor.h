// Keeps a resting part where it is on its moving support.
#pragma once

#include <Eigen/Geometry>

namespace robotcell {

/// Contact force on a body, split at its support's plane (N).
struct ContactForce {
  double normal = 0;
  Eigen::Vector3d tangential = Eigen::Vector3d::Zero();  // world
};

/// What the anchor remembers.
struct StickAnchorState {
  bool engaged = false;
  Eigen::Isometry3d support_from_body = Eigen::Isometry3d::Identity();
};

/// A velocity-level friction solver lets a body on a turning table creep outwards a little every step,
/// although friction holds it. While the friction used stays below the Coulomb limit, the anchor puts the
/// body's in-plane pose (x, y and the turn about the normal) back to where it was when it came to rest on its
/// support; height and tilt stay with the dynamics. At the limit it lets go, and takes hold again where the
/// body comes to rest.
class StickAnchor {
 public:
  explicit StickAnchor(double friction) : friction_(friction) {}

  /// The pose that the body takes after a step, its plane being z = const in the support's frame.
  Eigen::Isometry3d settle(const Eigen::Isometry3d& support_from_body, const ContactForce& force);

  const StickAnchorState& state() const { return state_; }
  void restore(const StickAnchorState& state) { state_ = state; }

 private:
  double friction_;
  StickAnchorState state_;
};

}  // namespace robotcell
