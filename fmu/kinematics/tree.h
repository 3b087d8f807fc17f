// A tree of joints: poses and twists of its frames, and the Jacobian of a point.
#pragma once

#include <Eigen/Geometry>
#include <vector>

namespace robotcell {

/// Pose and twist of a frame in the world (velocity of its origin).
struct Motion {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();
};

/// Motion of a frame that is fixed to a moving body.
Motion attached(const Motion& body, const Eigen::Isometry3d& body_from_frame);

/// The world, as the parent of a joint or the frame of a body.
constexpr int kWorld = -1;

/// A joint, and the frame that it carries.  The frame turns about z of the joint, or slides along it, between
/// two constant poses: `parent_from_joint Rz(q) joint_from_frame`.
struct Joint {
  enum class Kind { kFixed, kRevolute, kPrismatic };
  Kind kind = Kind::kFixed;
  int parent = kWorld;  // joint whose frame carries this one; comes before it
  int axis = -1;        // place of q in the positions of the axes, rad or m; none for a fixed joint
  Eigen::Isometry3d parent_from_joint = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d joint_from_frame = Eigen::Isometry3d::Identity();
};

/// Deviation of a joint from its pose on its parent, relative to it: the wobble of an axis, a vibration.
struct Deviation {
  int joint = 0;
  Motion motion;
};

/// Poses of the joints before their motion, and of the frames that they carry.
struct PlacedTree {
  std::vector<Eigen::Isometry3d> joints, frames;
};

/// Joints in the order of their numbers, parents first.
class Tree {
 public:
  /// Throws std::invalid_argument where a parent does not come before its joint, or an axis is missing.
  explicit Tree(std::vector<Joint> joints);

  std::size_t size() const { return nodes_.size(); }
  const Joint& operator[](std::size_t i) const { return nodes_[i].joint; }
  /// Joints that move a frame, from the world on.
  const std::vector<int>& path(int frame) const;
  /// Number of joints that move both frames.
  std::size_t common(int frame, int other) const;

  /// Poses at positions of the axes, without deviations.
  void place(const double* position, PlacedTree& placed) const;
  /// Motions of all frames at positions and rates of the axes.
  std::vector<Motion> motions(const double* position, const double* rate,
                              const std::vector<Deviation>& deviations) const;
  /// Motion of one frame, as by `motions`.
  Motion frame(int frame, const double* position, const double* rate,
               const std::vector<Deviation>& deviations) const;

  /// Column of the geometric Jacobian of a point (world) by a joint that moves it, in world axes: velocity of
  /// the point, then angular velocity.
  Eigen::Matrix<double, 6, 1> column(const PlacedTree& placed, int joint, const Eigen::Vector3d& point) const;

 private:
  struct Node {
    Joint joint;
    bool displaced_before = false, displaced_behind = false;  // by a pose that is not the identity
  };

  /// Moves on from the frame of the parent of a joint to its frame.
  void advance(int joint, const double* position, const double* rate,
               const std::vector<Deviation>& deviations, Motion& motion) const;

  std::vector<Node> nodes_;
  std::vector<std::vector<int>> paths_;    // joints that move the world, then each frame
  std::vector<std::vector<int>> carried_;  // joints on the way to each frame
};

}  // namespace robotcell
