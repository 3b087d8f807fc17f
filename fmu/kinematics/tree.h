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

/// The frame that everything stands in: the first of every tree.
constexpr std::size_t kWorld = 0;

/// A joint, and the frame that it carries.  The frame turns about z of the joint, or slides along it, between
/// two constant poses: `parent_from_joint Rz(q) joint_from_frame`.
struct Joint {
  enum class Kind { kFixed, kRevolute, kPrismatic };
  Kind kind = Kind::kFixed;
  std::size_t parent = kWorld;  // joint whose frame carries this one; comes before it
  std::size_t axis = 0;         // place of q in the positions of the axes, rad or m; unused by a fixed joint
  Eigen::Isometry3d parent_from_joint = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d joint_from_frame = Eigen::Isometry3d::Identity();
};

/// Deviation of a joint from its pose on its parent, relative to it: the wobble of an axis, a vibration.
struct Deviation {
  std::size_t joint = kWorld;
  Motion motion;
};

/// Poses of the joints before their motion, and of the frames that they carry.
struct PlacedTree {
  std::vector<Eigen::Isometry3d> joints, frames;
};

/// Joints in the order of their numbers, parents first.  Number 0 is the world, so that every other frame has
/// a parent.
class Tree {
 public:
  Tree() : nodes_(1), paths_(1), carried_(1) {}
  /// Adds a joint and returns its number.  Throws std::invalid_argument where the parent does not come before
  /// it.
  std::size_t add(const Joint& joint);

  std::size_t size() const { return nodes_.size(); }
  const Joint& operator[](std::size_t i) const { return nodes_[i].joint; }
  /// Joints that move a frame, from the world on.
  const std::vector<std::size_t>& path(std::size_t frame) const { return paths_[frame]; }
  /// Number of joints that move both frames.
  std::size_t common(std::size_t frame, std::size_t other) const;

  /// Poses at positions of the axes, without deviations.
  void place(const double* position, PlacedTree& placed) const;
  /// Motions of all frames at positions and rates of the axes.
  std::vector<Motion> motions(const double* position, const double* rate,
                              const std::vector<Deviation>& deviations) const;
  /// Motion of one frame, as by `motions`.
  Motion frame(std::size_t frame, const double* position, const double* rate,
               const std::vector<Deviation>& deviations) const;

  /// Column of the geometric Jacobian of a point (world) by a joint that moves it, in world axes: velocity of
  /// the point, then angular velocity.
  Eigen::Matrix<double, 6, 1> column(const PlacedTree& placed, std::size_t joint,
                                     const Eigen::Vector3d& point) const;

 private:
  struct Node {
    Joint joint;
    bool displaced_before = false, displaced_behind = false;  // by a pose that is not the identity
  };

  /// Moves on from the frame of the parent of a joint to its frame.
  void advance(std::size_t joint, const double* position, const double* rate,
               const std::vector<Deviation>& deviations, Motion& motion) const;

  std::vector<Node> nodes_;
  std::vector<std::vector<std::size_t>> paths_;    // joints that move each frame
  std::vector<std::vector<std::size_t>> carried_;  // joints on the way to each frame
};

}  // namespace robotcell
