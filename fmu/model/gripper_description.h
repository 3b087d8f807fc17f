// A gripper with two parallel fingers.
#pragma once

#include <Eigen/Geometry>

namespace robotcell {

class JsonReader;

/// The gripper's frame lies between the fingers where they begin: x along the closing, z towards their tips.
/// The frame of the first finger is the gripper's, moved along +x by half the width, so that the pad is its
/// plane x = 0; that of the second is turned about z by half a turn.
struct GripperDescription {
  Eigen::Isometry3d flange_from_gripper = Eigen::Isometry3d::Identity();
  double stroke = 0;                                 // greatest width between the pads
  Eigen::Vector3d finger = Eigen::Vector3d::Zero();  // thickness (x), width (y), length (z)
  double finger_mass = 0;
  double max_force = 0;           // of each finger, N
  double max_speed = 0;           // of each finger, m/s
  double friction = 0;            // of the pads
  double centring_stiffness = 0;  // N/m, between the shifts of the two fingers
  double start = 0;               // width between the pads

  /// Frame of a finger (0 or 1) at a distance from the middle.
  Eigen::Isometry3d flange_from_finger(std::size_t finger, double opening) const;
};

/// Throws DescriptionError.
GripperDescription parse_gripper(const JsonReader& json);

}  // namespace robotcell
