#include "fmu/proximity/pair_watch.h"

#include <fcl/narrowphase/collision.h>
#include <fcl/narrowphase/detail/primitive_shape_algorithm/triangle_distance.h>
#include <fcl/narrowphase/distance.h>

#include <cmath>

#include "fmu/proximity/collision_body.h"
#include "fmu/proximity/depth.h"

namespace robotcell::proximity {
namespace {

/// Pairs of intersecting faces that are looked at for the depth.
constexpr std::size_t kMostContacts = 1000;

/// Far above what rounding does to distances, far below what counts (m).
constexpr double kRounding = 1e-9;

/// How far beyond what is asked for a pair is searched, so that it need not be again while it moves less (m).
constexpr double kBeyond = 0.01;

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

/// No point of a body moved farther than this between two poses; with a margin for rounding where it moved.
double farthest_moved(const BodySet::Body& body, const Eigen::Isometry3d& before,
                      const Eigen::Isometry3d& now) {
  if (before.matrix() == now.matrix()) return 0;
  const double turned = (now.linear() - before.linear()).norm() / std::sqrt(2.0);
  return (now.translation() - before.translation()).norm() + turned * body.radius + kRounding;
}

bool has(const BodySet::Body& a, const BodySet::Body& b, const FacePair& faces) {
  return faces.first < a.mesh.faces.size() && faces.second < b.mesh.faces.size();
}

/// Distance of two faces, in the library's own arithmetic: the same number as its search of all faces gives.
double face_distance(const BodySet::Body& a, const BodySet::Body& b, const FacePair& faces) {
  const Corners p = corners(a.mesh, static_cast<std::size_t>(faces.first));
  const Corners q = corners(b.mesh, static_cast<std::size_t>(faces.second));
  const Eigen::Matrix3d a_from_world = a.world_from_body.linear().transpose();
  const Eigen::Matrix3d turn = a_from_world * b.world_from_body.linear();
  const Eigen::Vector3d shift =
      a_from_world * (b.world_from_body.translation() - a.world_from_body.translation());
  Eigen::Vector3d on_a, on_b;
  return fcl::detail::TriangleDistanced::triDistance(p.a, p.b, p.c, q.a, q.b, q.c, turn, shift, on_a, on_b);
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
    if (at_least(i, bodies) > 0 || apart(a, b) || !intersect(a, b)) continue;
    const Depth depth = depth_at(a, b, intersections(a, b));
    found.push_back({i, depth.point, depth.depth});
  }
  return found;
}

double PairWatch::at_least(std::size_t pair, const BodySet& bodies) const {
  const auto& a = bodies.body(pairs_[pair].first);
  const auto& b = bodies.body(pairs_[pair].second);
  const Eigen::Isometry3d a_from_b = a.world_from_body.inverse() * b.world_from_body;
  return known_[pair].at_least - farthest_moved(b, known_[pair].a_from_b, a_from_b);
}

std::optional<Nearest> PairWatch::nearest(const BodySet& bodies, double bound,
                                          const std::optional<Nearest>& last) {
  std::optional<Nearest> found;
  const auto improve = [&](const Nearest& candidate) {
    if (!(candidate.distance < bound)) return;
    bound = candidate.distance;
    found = candidate;
  };
  if (last) {
    const auto& a = bodies.body(pairs_[last->pair].first);
    const auto& b = bodies.body(pairs_[last->pair].second);
    if (has(a, b, last->faces)) improve({last->pair, last->faces, face_distance(a, b, last->faces)});
  }
  for (std::size_t i = 0; i < pairs_.size() && bound > 0; ++i) {
    const auto& a = bodies.body(pairs_[i].first);
    const auto& b = bodies.body(pairs_[i].second);
    if (at_least(i, bodies) >= bound) continue;
    fcl::DistanceResultd result;
    result.min_distance = bound + kBeyond;  // the search only improves on it
    fcl::distance(a.model.get(), a.world_from_body, b.model.get(), b.world_from_body, fcl::DistanceRequestd(),
                  result);
    known_[i] = {a.world_from_body.inverse() * b.world_from_body, result.min_distance};
    const FacePair faces{static_cast<std::size_t>(result.b1), static_cast<std::size_t>(result.b2)};
    improve({i, faces, std::max(result.min_distance, 0.0)});
  }
  return found;
}

}  // namespace robotcell::proximity
