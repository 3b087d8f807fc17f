// Description of a gripper with two parallel fingers.
#pragma once

#include <Eigen/Geometry>

namespace robotcell {

class JsonReader;

/// The gripper frame lies between the bases of the fingers: x along the closing direction, z towards the
/// tips. The frame of finger 1 is the gripper frame displaced along +x by half the width, so that the pad is
/// its plane x = 0; that of finger 2 is rotated about z by pi.
struct GripperDescription {
  Eigen::Isometry3d flange_from_gripper = Eigen::Isometry3d::Identity();
  double stroke = 0;                                 // m, maximum width between the pads
  Eigen::Vector3d finger = Eigen::Vector3d::Zero();  // m: thickness (x), width (y), length (z)
  double finger_mass = 0;
  double max_force = 0;           // N, of each finger
  double max_speed = 0;           // m/s, of each finger
  double friction = 0;            // of the pads
  double centring_stiffness = 0;  // N/m, for the difference of the finger positions
  double start = 0;               // m, initial width between the pads

  /// Frame of a finger (0 or 1) at a distance (m) from the middle.
  Eigen::Isometry3d flange_from_finger(std::size_t finger, double opening) const;
};

/// Throws DescriptionError.
GripperDescription parse_gripper(const JsonReader& json);

}  // namespace robotcell
