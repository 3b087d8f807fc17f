// Which of given pairs of bodies collide, and which is nearest to it.
#pragma once

#include <Eigen/Core>
#include <utility>
#include <vector>

#include "fmu/proximity/body_set.h"

namespace robotcell::proximity {

struct Collision {
  std::size_t pair = 0;
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // world
  double depth = 0;                                 // m
};

struct Nearest {
  std::size_t pair = 0;
  double distance = 0;  // m; 0 where surfaces intersect
};

class PairWatch {
 public:
  using Pair = std::pair<std::size_t, std::size_t>;

  explicit PairWatch(std::vector<Pair> pairs) : pairs_(std::move(pairs)) {}

  const Pair& pair(std::size_t number) const { return pairs_[number]; }

  /// Depth and deepest point of each pair whose surfaces intersect.
  std::vector<Collision> collisions(const BodySet& bodies) const;

  /// The smallest of all distances, exact below `bound`; nothing where all are beyond it. Asks the pair
  /// `first` (of the last answer, for example) before the others: its distance lets them be passed over.
  std::optional<Nearest> nearest(const BodySet& bodies, double bound, std::size_t first) const;

 private:
  std::vector<Pair> pairs_;
};

}  // namespace robotcell::proximity
