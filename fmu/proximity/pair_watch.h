// Which of given pairs of bodies collide, and which is nearest to it.
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

/// The smallest distance, and the two faces that have it.
struct Nearest {
  std::size_t pair = 0;
  FacePair faces{0, 0};
  double distance = 0;  // m; 0 where surfaces intersect
};

class PairWatch {
 public:
  using Pair = std::pair<std::size_t, std::size_t>;

  explicit PairWatch(std::vector<Pair> pairs) : pairs_(std::move(pairs)), known_(pairs_.size()) {}

  const Pair& pair(std::size_t number) const { return pairs_[number]; }

  /// Depth and deepest point of each pair whose surfaces intersect.
  std::vector<Collision> collisions(const BodySet& bodies) const;

  /// The smallest of all distances, exact below `bound`; nothing where all are beyond it. `last` is an
  /// earlier answer: the distance that its faces have now lets most others be passed over.
  ///
  /// What earlier searches found out about a pair is kept, and spares those that cannot have come near enough
  /// since; that decides how long the answer takes, never the answer. The bodies must be the same every time.
  std::optional<Nearest> nearest(const BodySet& bodies, double bound, const std::optional<Nearest>& last);

 private:
  /// At this relative pose a pair's distance is no less than that.
  struct Known {
    Eigen::Isometry3d a_from_b = Eigen::Isometry3d::Identity();
    double at_least = 0;  // m
  };

  /// What is known of a pair's distance without a search.
  double at_least(std::size_t pair, const BodySet& bodies) const;

  std::vector<Pair> pairs_;
  std::vector<Known> known_;
};

}  // namespace robotcell::proximity
