// Search for the closest faces of two bodies.
#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <optional>
#include <vector>

#include "fmu/proximity/bounding_tree.h"
#include "fmu/proximity/collision_body.h"
#include "fmu/proximity/triangle.h"

namespace robotcell::proximity {

/// A mesh prepared for `PairSearch`.
struct SearchBody {
  explicit SearchBody(std::shared_ptr<const Shape> of) : shape(std::move(of)), tree(*shape) {}
  explicit SearchBody(TriangleMesh mesh) : SearchBody(std::make_shared<const Shape>(std::move(mesh))) {}

  std::shared_ptr<const Shape> shape;
  BoundingTree tree;
};

struct ClosestFaces {
  double distance = 0;         // m; 0 where the surfaces intersect or touch
  Eigen::Vector3d on_a, on_b;  // closest points, frame of a; undefined where the distance is 0
};

/// Motion of the points of one body while the other one rests, frame of the first body.
struct Sweep {
  bool of_first = false;               // whether it is the first body that moves
  Eigen::Vector3d at, velocity, turn;  // m, m, rad
  double clearance = 0;                // m to keep meanwhile, with what else moves in any direction

  /// Points move by this (m) times -1 to 1.
  Eigen::Vector3d motion(const Eigen::Vector3d& point) const { return velocity + turn.cross(point - at); }
};

/// Two nodes that a search left out or compared.
struct FrontNode {
  /// Lower bound on their distance when it was computed, plus the `travelled` of that moment, m.
  double at_least;
  int a, b;
};

/// What earlier searches of a pair established.
struct PairMemory {
  Eigen::Isometry3d a_from_b = Eigen::Isometry3d::Identity();
  double at_least = -1;           // lower bound on the distance at that pose, m; negative: none
  std::optional<FacePair> faces;  // the closest ones
  std::vector<FrontNode> front;   // covers all pairs of faces; empty: none
  double travelled = 0;           // upper bound on the relative motion since the front began, m
  std::size_t first_size = 0;     // of the front when it began
  Eigen::Isometry3d enclosure_at = Eigen::Isometry3d::Identity();  // a_from_b where the following was found
  bool encloses = false;                                           // one body a piece of the other one
  double enclosure_holds = 0;  // while the bodies move by less than this from there, m
};

/// Branch and bound over two bounding trees. A search ends with a front: pairs of nodes that together contain
/// all pairs of faces, each with a lower bound on its distance. The next search begins with those whose
/// bound, less the motion since, does not rule them out. One object serves one thread and any number of
/// pairs.
class PairSearch {
 public:
  /// Closest faces of two bodies where their distance is below `bound`. `memory` belongs to the pair; it
  /// reduces the work and changes the distance by less than `kTolerance`.
  std::optional<ClosestFaces> closest(const SearchBody& a, const SearchBody& b,
                                      const Eigen::Isometry3d& a_from_b, double bound, PairMemory& memory) {
    return search(a, b, a_from_b, bound, memory, 0, kPatient, nullptr);
  }

  /// Some faces nearer than `bound` that do not keep the clearance of a sweep, where there are any. The
  /// search for nearer ones ends below `near_enough`, or `patience` comparisons after the first.
  std::optional<ClosestFaces> near(const SearchBody& a, const SearchBody& b,
                                   const Eigen::Isometry3d& a_from_b, double bound, PairMemory& memory,
                                   double near_enough, std::size_t patience, const Sweep& sweep) {
    return search(a, b, a_from_b, bound, memory, near_enough, patience, &sweep);
  }

  /// Whether a closed mesh encloses a connected piece of the other one, for bodies whose surfaces are at
  /// least `apart` (m) from each other. Nothing is inside an open mesh, which itself can be inside a closed
  /// one.
  bool encloses(const SearchBody& a, const SearchBody& b, const Eigen::Isometry3d& a_from_b, double apart,
                PairMemory& memory);

  /// Nodes and faces compared since the search was made: a measure of its work independent of the clock.
  std::size_t work() const { return work_; }

  /// Nodes are left out unless they can reduce the distance by more than this (m). Parallel faces have as
  /// many closest pairs of triangles as they have triangles: one of them is enough.
  static constexpr double kTolerance = 5e-13;

 private:
  struct Node {
    double at_least;
    int a, b;
  };
  struct NodeDistance {
    double at_least;   // lower bound, m
    bool stays_clear;  // whether the sweep is proved to bring no points nearer than its clearance
  };
  /// Planes perpendicular to the line between the closest points found so far; in both frames.
  struct Planes {
    Eigen::Vector3d normal_in_a, normal_in_b;
  };

  static constexpr std::size_t kPatient = std::size_t{1} << 62;

  std::optional<ClosestFaces> search(const SearchBody& a, const SearchBody& b,
                                     const Eigen::Isometry3d& a_from_b, double bound, PairMemory& memory,
                                     double near_enough, std::size_t patience, const Sweep* sweep);
  void begin(double moved, PairMemory& memory);
  void descend();
  void leave_out(double at_least, int node_a, int node_b);
  void visit(int node_a, int node_b);
  NodeDistance distance_bound(int node_a, int node_b) const;
  bool is_near_enough() const { return best_ == 0 || best_ < near_enough_ || work_ > give_up_; }
  bool stays_clear(const Eigen::Vector3d& normal, double gap, const Eigen::Vector3d& centre,
                   double radius) const;
  bool stays_clear(const Corners& a, const Corners& b, const Eigen::Vector3d& normal) const;
  bool split_first(const Node& node) const;
  double compare(const FacePair& faces);
  bool is_inside(const Eigen::Vector3d& point, const SearchBody& body);

  /// Distance below which a node is of interest.
  double limit() const { return best_ - kTolerance; }

  const SearchBody* a_ = nullptr;
  const SearchBody* b_ = nullptr;
  Eigen::Matrix3d rotation_;     // a_from_b
  Eigen::Vector3d translation_;  // a_from_b
  std::vector<Node> stack_;
  const Sweep* sweep_ = nullptr;
  std::optional<Planes> planes_;
  std::optional<FacePair> faces_;
  std::optional<FacePair> nearest_;  // of all that were compared
  double nearest_distance_ = 0;      // m
  ClosestFaces closest_;
  double best_ = 0;  // distances from here on are of no interest
  double bound_ = 0, near_enough_ = 0;
  double at_least_ = 0;   // smallest lower bound of all nodes left out
  double slack_ = 0;      // lower bounds are refined up to the limit and this, for the sake of later poses
  double travelled_ = 0;  // as in the memory
  std::size_t work_ = 0, patience_ = 0;
  std::size_t give_up_ = 0;  // work at which to end
  std::vector<FrontNode> front_;
};

}  // namespace robotcell::proximity
