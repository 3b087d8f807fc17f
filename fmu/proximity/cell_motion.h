// Poses of the bodies of a cell, and bounds on their motion relative to each other.
#pragma once

#include <Eigen/Geometry>
#include <utility>
#include <vector>

#include "fmu/kinematics/tree.h"

namespace robotcell::proximity {

/// A body, the frame that carries it, and a sphere about it.
struct CarriedBody {
  std::size_t frame = kWorld;
  Eigen::Isometry3d frame_from_body = Eigen::Isometry3d::Identity();
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // of the bounding sphere, frame of the carrier, m
  double radius = 0;                                 // m
  /// Largest distance of its points from the axis of the last joint that moves it, m.
  double from_axis = 0;
};

/// Poses of tree and bodies at one position of the axes.
struct CellFrames {
  PlacedTree tree;
  std::vector<Eigen::Isometry3d> bodies;  // world_from_body
};

/// Motion of one body of a pair relative to the other while the axes go to either side of a position.
struct RelativeMotion {
  std::size_t moving = 0;  // body whose points p move by up to ±(velocity + turn x (p - at)) and `rest`
  Eigen::Vector3d at = Eigen::Vector3d::Zero();  // world, as the others, m
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero(), turn = Eigen::Vector3d::Zero();  // m, rad
  double rest = 0;                                                                     // m, in any direction
  double bound = 0;                                                                    // of all of it, m
};

/// Bodies on a tree.  Positions of the axes are in rad or m.
class CellMotion {
 public:
  using Pair = std::pair<std::size_t, std::size_t>;

  CellMotion(Tree tree, std::size_t axes, std::vector<CarriedBody> bodies, const std::vector<Pair>& pairs);

  std::size_t axes() const { return axes_; }
  std::size_t bodies() const { return bodies_.size(); }
  std::size_t pairs() const { return pairs_.size(); }

  void place(const double* axes, CellFrames& frames) const;

  /// Pose of a tool on a frame, and the geometric Jacobian of its origin in world axes, (6, axes): linear
  /// velocity, then angular velocity.
  Eigen::Isometry3d place_tool(const double* axes, std::size_t frame,
                               const Eigen::Isometry3d& frame_from_tool,
                               Eigen::Matrix<double, 6, Eigen::Dynamic>& jacobian) const;

  /// Motion of one body of a pair relative to the other, from where the frames are, while each axis follows a
  /// straight line by up to `half` (axes,) times -1 to 1 and deviates from it by up to `slack` (axes,).
  RelativeMotion motion(const CellFrames& frames, std::size_t pair, const double* half,
                        const double* slack) const;

 private:
  struct MovingPair {
    std::size_t a = 0, b = 0;  // the bodies: that which more joints move and not the other one comes first
    std::size_t common = 0;    // joints that move both
  };

  RelativeMotion motion_of(const CellFrames& frames, std::size_t body, std::size_t common, const double* half,
                           const double* slack) const;

  Tree tree_;
  std::size_t axes_;
  std::vector<CarriedBody> bodies_;
  std::vector<MovingPair> pairs_;
};

}  // namespace robotcell::proximity
