// Kinematics of the bodies of a cell, and bounds on their motion relative to each other.
#pragma once

#include <Eigen/Geometry>
#include <utility>
#include <vector>

namespace robotcell::proximity {

/// Revolute joint: `Rz(q + theta) T(a, 0, d) twist`, m and rad.
struct ChainJoint {
  double a = 0, d = 0, theta = 0;
  Eigen::Matrix3d twist = Eigen::Matrix3d::Identity();
};

/// A body and what carries it.
struct CarriedBody {
  int carried = 0;        // joints that carry it
  bool on_table = false;  // whether it turns with the table; then no joint carries it
  Eigen::Isometry3d carrier_from_body = Eigen::Isometry3d::Identity();  // from the last link, table or world
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // of the bounding sphere, frame of the carrier, m
  double radius = 0;                                 // m
  double table_radius = 0;  // largest distance of its points from the table's axis, m
};

/// Frames at one position of the axes.
struct CellFrames {
  std::vector<Eigen::Isometry3d> links;                     // world_from_link, base first
  std::vector<Eigen::Isometry3d> bodies;                    // world_from_body
  Eigen::Isometry3d table = Eigen::Isometry3d::Identity();  // world_from_table
};

/// Motion of one body of a pair relative to the other while the axes go to either side of a position.
struct RelativeMotion {
  std::size_t moving = 0;  // body whose points p move by up to ±(velocity + turn x (p - at)) and `rest`
  Eigen::Vector3d at = Eigen::Vector3d::Zero();  // world, as the others, m
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero(), turn = Eigen::Vector3d::Zero();  // m, rad
  double rest = 0;                                                                     // m, in any direction
  double bound = 0;                                                                    // of all of it, m
};

/// A serial arm and a table that turns about z.  Axes are the joints and the table, rad.
class CellMotion {
 public:
  using Pair = std::pair<std::size_t, std::size_t>;

  CellMotion(std::vector<ChainJoint> joints, const Eigen::Isometry3d& world_from_base,
             const Eigen::Isometry3d& world_from_table, std::vector<CarriedBody> bodies,
             const std::vector<Pair>& pairs);

  std::size_t axes() const { return joints_.size() + 1; }
  std::size_t bodies() const { return bodies_.size(); }
  std::size_t pairs() const { return pairs_.size(); }

  void place(const double* axes, CellFrames& frames) const;

  /// Pose of a tool on the last link, and the geometric Jacobian of its origin in world axes: linear
  /// velocity, then angular velocity. `axes` are the joints and the table.
  Eigen::Isometry3d place_tool(const double* axes, const Eigen::Isometry3d& link_from_tool,
                               Eigen::Matrix<double, 6, Eigen::Dynamic>& jacobian) const;

  /// Motion of one body of a pair relative to the other, from where the frames are, while each axis follows a
  /// straight line by up to `half` (axes,) times -1 to 1 and deviates from it by up to `slack` (axes,), rad.
  RelativeMotion motion(const CellFrames& frames, std::size_t pair, const double* half,
                        const double* slack) const;

 private:
  struct MovingPair {
    std::size_t outer = 0;    // the body that more joints carry
    int first = 0;            // joint that carries it and not the other one; all later ones do, too
    bool turns = false;       // whether the table turns one of both
    std::size_t turning = 0;  // that one
  };

  RelativeMotion motion_by_table(const CellFrames& frames, std::size_t turning, double half,
                                 double slack) const;

  std::vector<ChainJoint> joints_;
  Eigen::Isometry3d world_from_base_, world_from_table_;
  std::vector<CarriedBody> bodies_;
  std::vector<MovingPair> pairs_;
  std::vector<double> length_;  // of the links up to each, m
};

}  // namespace robotcell::proximity
