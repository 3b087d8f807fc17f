// Collisions and smallest distance among given pairs of bodies.
#pragma once

#include <Eigen/Geometry>
#include <utility>
#include <vector>

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
  double distance = 0;  // m; 0 where surfaces intersect
};

class PairMonitor {
 public:
  using Pair = std::pair<std::size_t, std::size_t>;

  explicit PairMonitor(std::vector<Pair> pairs) : pairs_(std::move(pairs)), bounds_(pairs_.size()) {}

  const Pair& pair(std::size_t number) const { return pairs_[number]; }

  /// Depth and deepest point of each pair whose surfaces intersect.
  std::vector<Collision> collisions(const BodySet& bodies) const;

  /// The smallest of all distances, exact below `bound`; empty where all exceed it. `last` is an earlier
  /// result: the present distance of its faces bounds the search.
  ///
  /// Lower bounds from earlier searches are kept, to skip pairs that cannot have come close enough since.
  /// They affect the cost, not the result. The bodies must be the same in every call.
  std::optional<Nearest> nearest(const BodySet& bodies, double bound, const std::optional<Nearest>& last);

 private:
  /// Lower bound of a pair's distance at a relative pose.
  struct DistanceBound {
    Eigen::Isometry3d a_from_b = Eigen::Isometry3d::Identity();
    double lower_bound = 0;  // m
  };

  /// Lower bound of a pair's distance at the present poses.
  double lower_bound(std::size_t pair, const BodySet& bodies) const;

  std::vector<Pair> pairs_;
  std::vector<DistanceBound> bounds_;
};

}  // namespace robotcell::proximity
