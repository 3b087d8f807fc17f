// Collisions and smallest distance among given pairs of bodies.
#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "fmu/proximity/pair_search.h"
#include "fmu/proximity/triangle.h"

namespace robotcell::proximity {

struct Collision {
  std::size_t pair = 0;
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // world
  double depth = 0;                                 // m
};

/// The smallest distance and the two closest faces.
struct Nearest {
  std::size_t pair = 0;
  FacePair faces{0, 0};
  double distance = 0;  // m; 0 where surfaces intersect or one body encloses the other
};

/// Two bodies collide where their surfaces intersect, or where one encloses a connected piece of the other.
///
/// What earlier calls established is kept, to skip pairs that cannot have come close enough since. It affects
/// the cost, not the results. The bodies must be the same in every call.
class PairMonitor {
 public:
  using Pair = std::pair<std::size_t, std::size_t>;

  explicit PairMonitor(std::vector<Pair> pairs)
      : pairs_(std::move(pairs)),
        bounds_(pairs_.size()),
        clear_up_to_(pairs_.size(), 0),
        memory_(pairs_.size()) {}

  const Pair& pair(std::size_t number) const { return pairs_[number]; }

  /// Depth and deepest point of each pair that collides.
  std::vector<Collision> collisions(const BodySet& bodies) const;

  /// Begins to follow the bodies, from their present poses.
  void begin(const BodySet& bodies);

  /// Collisions on the way of the bodies from their poses in the last call of this or `begin` to the present
  /// ones, of pairs that did not collide at the last one and are not in `left_out`. In between, the centre of
  /// one body of a pair moves relative to the other at constant velocity, and the body turns about a fixed
  /// axis.
  ///
  /// The way is halved until each part is proved to be free, by distance and motion as in `MotionProof`, or
  /// is shorter than `kFinest`. So at worst a graze of less than this depth is missed. A pair is reported
  /// once, at the first colliding pose found.
  std::vector<Collision> follow(const BodySet& bodies, const Selection& left_out);

  static constexpr double kFinest = 5e-5;  // m

  /// The smallest of all distances, exact below `bound`; empty where all exceed it. `last` is an earlier
  /// result: the present distance of its faces bounds the search.
  std::optional<Nearest> nearest(const BodySet& bodies, double bound, const std::optional<Nearest>& last);

 private:
  /// Lower bound of the distance of a pair's surfaces at a relative pose.
  struct DistanceBound {
    Eigen::Isometry3d larger_from_smaller = Eigen::Isometry3d::Identity();
    double lower_bound = 0;  // m
    bool encloses = false;   // one of the bodies the other one, there
  };
  class Way;

  /// Bodies of a pair: the smaller one moves less far where it rotates.
  std::pair<std::size_t, std::size_t> larger_and_smaller(std::size_t pair, const BodySet& bodies) const;

  /// Lower bound of a pair's distance at the present poses.
  double lower_bound(std::size_t pair, const BodySet& bodies) const;

  /// The collision in a part of the way, from the fraction `middle` by `half` to either side.
  std::optional<Collision> collision_on(const Way& way, const BodySet& bodies, double middle, double half);

  const SearchBody& search_body(std::size_t body, const BodySet& bodies);

  std::vector<Pair> pairs_;
  std::vector<DistanceBound> bounds_;
  std::vector<Eigen::Isometry3d> followed_;  // world_from_body up to which the bodies are followed
  double travelled_ = 0;             // m, bound on the relative motion of any two bodies since `begin`
  std::vector<double> clear_up_to_;  // value of `travelled_` up to which a pair cannot collide
  PairSearch search_;
  std::vector<PairMemory> memory_;                                // of the search, for each pair
  std::vector<std::shared_ptr<const SearchBody>> search_bodies_;  // null until needed
};

}  // namespace robotcell::proximity
