// Distances, closest points and collisions of pairs of bodies, for many poses in one call.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "fmu/proximity/body_set.h"

namespace robotcell::proximity {

struct SearchBody;

/// Poses of all bodies at several instants.
struct PoseBatch {
  const double* world_from_body = nullptr;  // (count, bodies, 4, 4), row-major rigid transforms, m
  std::size_t count = 0;
};

/// Distances are between surfaces; they are 0 where surfaces intersect, or a closed mesh encloses a connected
/// piece of the other one. Nothing is inside an open mesh.
///
/// What a search finds out about a pair carries over to the next pose, which saves time along a path and
/// changes distances by less than 1e-12 m. Threads take blocks of consecutive poses whose size depends on
/// nothing but their number, so that the results are the same bytes for any number of threads. `threads` = 0
/// uses all cores. Queries may run in parallel.
class PairDistances {
 public:
  using Pair = std::pair<std::size_t, std::size_t>;

  /// Meshes in the body frame, m; pairs of their numbers. Throws std::invalid_argument for a mesh without
  /// faces and for a pair that names a body that does not exist, or one body twice.
  PairDistances(std::vector<TriangleMesh> meshes, std::vector<Pair> pairs);

  /// The same bodies with other pairs; their bounding volumes are shared.
  PairDistances(const PairDistances& other, std::vector<Pair> pairs);

  std::size_t bodies() const { return bodies_.size(); }
  std::size_t pairs() const { return pairs_.size(); }
  const Pair& pair(std::size_t number) const { return pairs_[number]; }
  const SearchBody& body(std::size_t number) const { return *bodies_[number]; }

  /// Distances (count, pairs), m, exact below their bound and equal to it otherwise; 0 where bodies
  /// intersect.
  ///
  /// `bounds` (count, pairs), m. `closest_points`, unless null, receives (count, pairs, 2, 3), m: the closest
  /// points of the first and second body in the world, NaN where the distance is 0 or not below the bound.
  void distances(const PoseBatch& poses, const double* bounds, unsigned threads, double* distances,
                 double* closest_points = nullptr) const;

  /// Whether the bodies intersect (count, pairs): whether their distance is 0.
  void collisions(const PoseBatch& poses, unsigned threads, bool* intersecting) const;

 private:
  std::vector<std::shared_ptr<const SearchBody>> bodies_;
  std::vector<Pair> pairs_;
};

}  // namespace robotcell::proximity
