#include "fmu/proximity/pair_distances.h"

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <string>

#include "fmu/proximity/blocks.h"
#include "fmu/proximity/pair_search.h"

namespace robotcell::proximity {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

/// Poses that one thread takes at a time: enough for the first of them, which has no predecessor, to cost
/// little.
constexpr std::size_t kBlock = 128;

/// Surfaces at a smaller distance than this (m) are searched for an intersection.
constexpr double kContact = 1e-9;

void check(const std::vector<PairDistances::Pair>& pairs, std::size_t bodies) {
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    const auto& [a, b] = pairs[i];
    if (a < bodies && b < bodies && a != b) continue;
    throw std::invalid_argument("pairs: expected two different numbers below " + std::to_string(bodies) +
                                ", got (" + std::to_string(a) + ", " + std::to_string(b) + ") at pair " +
                                std::to_string(i));
  }
}

Isometry3d pose_at(const double* row_major) {
  using RowMajor = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
  Isometry3d pose;
  pose.matrix() = Eigen::Map<const RowMajor>(row_major);
  return pose;
}

/// Runs `found(pose, pair, world_from_a, closest)` for every pair at every pose of a block.
template <typename Found>
void search_block(const std::vector<std::shared_ptr<const SearchBody>>& bodies,
                  const std::vector<PairDistances::Pair>& pairs, const double* world_from_body,
                  std::size_t first, std::size_t last, const double* bounds, const Found& found) {
  PairSearch search;
  std::vector<PairMemory> memory(pairs.size());
  std::vector<Isometry3d> poses(bodies.size());
  for (std::size_t i = first; i < last; ++i) {
    for (std::size_t k = 0; k < bodies.size(); ++k) {
      poses[k] = pose_at(world_from_body + 16 * (i * bodies.size() + k));
    }
    for (std::size_t k = 0; k < pairs.size(); ++k) {
      const auto& [a, b] = pairs[k];
      const Isometry3d a_from_b = poses[a].inverse() * poses[b];
      const double bound = bounds[i * pairs.size() + k];
      auto closest = search.closest(*bodies[a], *bodies[b], a_from_b, bound, memory[k]);
      const double apart = closest ? closest->distance : bound;
      if (apart > 0 && search.encloses(*bodies[a], *bodies[b], a_from_b, apart, memory[k])) {
        closest = ClosestFaces{0, Vector3d::Zero(), Vector3d::Zero()};
      }
      found(i, k, poses[a], closest);
    }
  }
}

}  // namespace

PairDistances::PairDistances(std::vector<TriangleMesh> meshes, std::vector<Pair> pairs)
    : pairs_(std::move(pairs)) {
  check(pairs_, meshes.size());
  for (TriangleMesh& mesh : meshes) {
    if (mesh.faces.empty()) {
      throw std::invalid_argument("meshes: mesh " + std::to_string(bodies_.size()) + " has no faces");
    }
    bodies_.push_back(std::make_shared<SearchBody>(std::move(mesh)));
  }
}

PairDistances::PairDistances(const PairDistances& other, std::vector<Pair> pairs)
    : bodies_(other.bodies_), pairs_(std::move(pairs)) {
  check(pairs_, bodies_.size());
}

void PairDistances::distances(const PoseBatch& poses, const double* bounds, unsigned threads,
                              double* distances, double* closest_points) const {
  const auto store = [&](std::size_t pose, std::size_t pair, const Isometry3d& world_from_a,
                         const std::optional<ClosestFaces>& closest) {
    const std::size_t at = pose * pairs_.size() + pair;
    distances[at] = closest ? closest->distance : bounds[at];
    if (closest_points == nullptr) return;
    double* points = closest_points + 6 * at;
    if (closest && closest->distance > 0) {
      Eigen::Map<Vector3d>(points, 3) = world_from_a * closest->on_a;
      Eigen::Map<Vector3d>(points + 3, 3) = world_from_a * closest->on_b;
    } else {
      std::fill(points, points + 6, std::numeric_limits<double>::quiet_NaN());
    }
  };
  for_each_block(poses.count, kBlock, threads, [&](std::size_t first, std::size_t last) {
    search_block(bodies_, pairs_, poses.world_from_body, first, last, bounds, store);
  });
}

void PairDistances::collisions(const PoseBatch& poses, unsigned threads, bool* intersecting) const {
  const std::vector<double> bounds(poses.count * pairs_.size(), kContact);
  const auto store = [&](std::size_t pose, std::size_t pair, const Isometry3d&,
                         const std::optional<ClosestFaces>& closest) {
    intersecting[pose * pairs_.size() + pair] = closest && closest->distance == 0;
  };
  for_each_block(poses.count, kBlock, threads, [&](std::size_t first, std::size_t last) {
    search_block(bodies_, pairs_, poses.world_from_body, first, last, bounds.data(), store);
  });
}

}  // namespace robotcell::proximity
