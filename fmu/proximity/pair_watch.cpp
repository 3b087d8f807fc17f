#include "fmu/proximity/pair_watch.h"

#include <fcl/narrowphase/collision.h>
#include <fcl/narrowphase/distance.h>

#include "fmu/proximity/collision_body.h"
#include "fmu/proximity/depth.h"

namespace robotcell::proximity {
namespace {

/// Pairs of intersecting faces that are looked at for the depth.
constexpr std::size_t kMostContacts = 1000;

bool intersect(const BodySet::Body& a, const BodySet::Body& b) {
  fcl::CollisionResultd result;
  fcl::collide(a.model.get(), a.world_from_body, b.model.get(), b.world_from_body, fcl::CollisionRequestd(),
               result);
  return result.isCollision();
}

/// Whether a body's bounding box, seen from the other body, keeps away from that body's.
bool apart(const BodySet::Body& a, const BodySet::Body& b) {
  const Eigen::Isometry3d a_from_b = a.world_from_body.inverse() * b.world_from_body;
  return !b.bounds.transformed(a_from_b).intersects(a.bounds) ||
         !a.bounds.transformed(a_from_b.inverse()).intersects(b.bounds);
}

/// Faces of two bodies that intersect.
std::vector<FacePair> intersections(const BodySet::Body& a, const BodySet::Body& b) {
  fcl::CollisionResultd result;
  fcl::collide(a.model.get(), a.world_from_body, b.model.get(), b.world_from_body,
               fcl::CollisionRequestd(kMostContacts, true), result);
  std::vector<FacePair> pairs;
  for (std::size_t i = 0; i < result.numContacts(); ++i) {
    const auto& contact = result.getContact(i);
    pairs.emplace_back(contact.b1, contact.b2);
  }
  return pairs;
}

}  // namespace

std::vector<Collision> PairWatch::collisions(const BodySet& bodies) const {
  std::vector<Collision> found;
  for (std::size_t i = 0; i < pairs_.size(); ++i) {
    const auto& a = bodies.body(pairs_[i].first);
    const auto& b = bodies.body(pairs_[i].second);
    if (apart(a, b) || !intersect(a, b)) continue;
    const Depth depth = depth_at(a, b, intersections(a, b));
    found.push_back({i, depth.point, depth.depth});
  }
  return found;
}

std::optional<Nearest> PairWatch::nearest(const BodySet& bodies, double bound, std::size_t first) const {
  std::optional<Nearest> found;
  for (std::size_t k = 0; k < pairs_.size(); ++k) {
    // The favourite comes first, and changes places with number 0.
    const std::size_t i = k == 0 ? first : (k == first ? 0 : k);
    const auto& a = bodies.body(pairs_[i].first);
    const auto& b = bodies.body(pairs_[i].second);
    fcl::DistanceResultd result;
    result.min_distance = bound;  // the search only improves on it
    fcl::distance(a.model.get(), a.world_from_body, b.model.get(), b.world_from_body, fcl::DistanceRequestd(),
                  result);
    if (!(result.min_distance < bound)) continue;
    bound = std::max(result.min_distance, 0.0);
    found = Nearest{i, bound};
    if (bound == 0) break;
  }
  return found;
}

}  // namespace robotcell::proximity
