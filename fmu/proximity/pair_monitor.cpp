#include "fmu/proximity/pair_monitor.h"

#include <fcl/narrowphase/collision.h>
#include <fcl/narrowphase/distance.h>

#include "fmu/proximity/collision_body.h"
#include "fmu/proximity/depth.h"
#include "fmu/proximity/face_distance.h"
#include "fmu/proximity/motion_bound.h"

namespace robotcell::proximity {
namespace {

/// Maximum number of pairs of intersecting faces considered for the depth.
constexpr std::size_t kMaxFacePairs = 1000;

/// Distance beyond the bound up to which a pair is searched, so that the search need not be repeated for
/// small motions (m).
constexpr double kSearchMargin = 0.01;

bool intersect(const BodySet::Body& a, const BodySet::Body& b) {
  fcl::CollisionResultd result;
  fcl::collide(&a.shape->model, a.world_from_body, &b.shape->model, b.world_from_body,
               fcl::CollisionRequestd(), result);
  return result.isCollision();
}

/// Whether the bounding boxes of two bodies are disjoint.
bool boxes_disjoint(const BodySet::Body& a, const BodySet::Body& b) {
  const Eigen::Isometry3d a_from_b = a.world_from_body.inverse() * b.world_from_body;
  return !b.shape->bounds.transformed(a_from_b).intersects(a.shape->bounds) ||
         !a.shape->bounds.transformed(a_from_b.inverse()).intersects(b.shape->bounds);
}

bool has_faces(const BodySet::Body& a, const BodySet::Body& b, const FacePair& faces) {
  return faces.first < a.shape->mesh.faces.size() && faces.second < b.shape->mesh.faces.size();
}

/// Distance of two faces in the library's own arithmetic, to the bit the same as in its search.
double face_distance(const BodySet::Body& a, const BodySet::Body& b, const FacePair& faces) {
  const Eigen::Matrix3d a_from_world = a.world_from_body.linear().transpose();
  const Eigen::Matrix3d rotation = a_from_world * b.world_from_body.linear();
  const Eigen::Vector3d translation =
      a_from_world * (b.world_from_body.translation() - a.world_from_body.translation());
  return face_distance(corners(a.shape->mesh, faces.first), corners(b.shape->mesh, faces.second), rotation,
                       translation)
      .distance;
}

/// Pairs of intersecting faces of two bodies.
std::vector<FacePair> intersections(const BodySet::Body& a, const BodySet::Body& b) {
  fcl::CollisionResultd result;
  fcl::collide(&a.shape->model, a.world_from_body, &b.shape->model, b.world_from_body,
               fcl::CollisionRequestd(kMaxFacePairs, true), result);
  std::vector<FacePair> pairs;
  for (std::size_t i = 0; i < result.numContacts(); ++i) {
    const auto& contact = result.getContact(i);
    pairs.emplace_back(contact.b1, contact.b2);
  }
  return pairs;
}

}  // namespace

std::vector<Collision> PairMonitor::collisions(const BodySet& bodies) const {
  std::vector<Collision> found;
  for (std::size_t i = 0; i < pairs_.size(); ++i) {
    const auto& a = bodies.body(pairs_[i].first);
    const auto& b = bodies.body(pairs_[i].second);
    if (lower_bound(i, bodies) > 0 || boxes_disjoint(a, b) || !intersect(a, b)) continue;
    const Depth depth = depth_at(a, b, intersections(a, b));
    found.push_back({i, depth.point, depth.depth});
  }
  return found;
}

double PairMonitor::lower_bound(std::size_t pair, const BodySet& bodies) const {
  const auto& a = bodies.body(pairs_[pair].first);
  const auto& b = bodies.body(pairs_[pair].second);
  const Eigen::Isometry3d a_from_b = a.world_from_body.inverse() * b.world_from_body;
  return bounds_[pair].lower_bound -
         motion_bound(Eigen::Vector3d::Zero(), b.shape->radius, bounds_[pair].a_from_b, a_from_b);
}

std::optional<Nearest> PairMonitor::nearest(const BodySet& bodies, double bound,
                                            const std::optional<Nearest>& last) {
  std::optional<Nearest> found;
  const auto update = [&](const Nearest& candidate) {
    if (!(candidate.distance < bound)) return;
    bound = candidate.distance;
    found = candidate;
  };
  if (last) {
    const auto& a = bodies.body(pairs_[last->pair].first);
    const auto& b = bodies.body(pairs_[last->pair].second);
    if (has_faces(a, b, last->faces)) update({last->pair, last->faces, face_distance(a, b, last->faces)});
  }
  for (std::size_t i = 0; i < pairs_.size() && bound > 0; ++i) {
    const auto& a = bodies.body(pairs_[i].first);
    const auto& b = bodies.body(pairs_[i].second);
    if (lower_bound(i, bodies) >= bound) continue;
    fcl::DistanceResultd result;
    result.min_distance = bound + kSearchMargin;  // the search only looks for smaller distances
    fcl::distance(&a.shape->model, a.world_from_body, &b.shape->model, b.world_from_body,
                  fcl::DistanceRequestd(), result);
    bounds_[i] = {a.world_from_body.inverse() * b.world_from_body, result.min_distance};
    const FacePair faces{static_cast<std::size_t>(result.b1), static_cast<std::size_t>(result.b2)};
    update({i, faces, std::max(result.min_distance, 0.0)});
  }
  return found;
}

}  // namespace robotcell::proximity
