#include "fmu/proximity/pair_monitor.h"

#include <fcl/narrowphase/collision.h>
#include <fcl/narrowphase/distance.h>

#include <algorithm>

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

/// Motion between two instants that is too small to be looked at (m).
constexpr double kAtRest = 1e-7;

/// Comparisons of a search beyond the first that leaves a part of the way open.
constexpr std::size_t kPatience = 50;

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

/// Depth of two bodies that collide.
std::optional<Depth> collision_depth(const BodySet::Body& a, const BodySet::Body& b) {
  if (intersect(a, b)) return depth_at(a, b, intersections(a, b));
  if (one_encloses_other(a, b)) return depth_inside(a, b);
  return std::nullopt;
}

}  // namespace

/// Relative motion of a pair between two instants: the smaller body moves, the larger one rests.
class PairMonitor::Way {
 public:
  Way(std::size_t pair, std::size_t larger, std::size_t smaller, const std::vector<Eigen::Isometry3d>& before,
      const BodySet& bodies)
      : pair(pair),
        larger(larger),
        smaller(smaller),
        larger_(bodies.body(larger)),
        smaller_(bodies.body(smaller)),
        world_from_larger_(before[larger]),
        start_(before[larger].inverse() * before[smaller]) {
    const Eigen::Isometry3d end = larger_.world_from_body.inverse() * smaller_.world_from_body;
    travel_ = end * centre() - start_ * centre();
    turn_ = Eigen::AngleAxisd(end.linear() * start_.linear().transpose());
  }

  /// Bound on the way of any point, m.
  double length() const { return travel_.norm() + turn_.angle() * radius() + kRounding; }

  Eigen::Isometry3d larger_from_smaller(double fraction) const {
    Eigen::Isometry3d pose;
    pose.linear() = Eigen::AngleAxisd(fraction * turn_.angle(), turn_.axis()) * start_.linear();
    pose.translation() = start_ * centre() + fraction * travel_ - pose.linear() * centre();
    return pose;
  }

  /// Motion of the smaller body from a fraction of the way by `half` to either side.
  Sweep sweep(double fraction, double half) const {
    const double angle = half * turn_.angle();
    const double bend =
        angle * angle / 2 * radius();  // what the motion of a point deviates from a straight one
    return {false, start_ * centre() + fraction * travel_, half * travel_, angle * turn_.axis(),
            bend + kRounding};
  }

  /// Both bodies at a fraction of the way.
  std::pair<BodySet::Body, BodySet::Body> bodies_at(double fraction) const {
    const Eigen::Isometry3d& end = larger_.world_from_body;
    const Eigen::Quaterniond from(world_from_larger_.linear()), to(end.linear());
    std::pair<BodySet::Body, BodySet::Body> placed(larger_, smaller_);
    placed.first.world_from_body = Eigen::Translation3d((1 - fraction) * world_from_larger_.translation() +
                                                        fraction * end.translation()) *
                                   from.slerp(fraction, to);
    placed.second.world_from_body = placed.first.world_from_body * larger_from_smaller(fraction);
    return placed;
  }

  const std::size_t pair, larger, smaller;  // numbers

 private:
  const Eigen::Vector3d& centre() const { return smaller_.shape->centre; }
  double radius() const { return smaller_.shape->radius; }

  const BodySet::Body &larger_, &smaller_;
  Eigen::Isometry3d world_from_larger_;  // at the start
  Eigen::Isometry3d start_;              // larger_from_smaller
  Eigen::Vector3d travel_;               // of the centre of the smaller body, m, frame of the larger one
  Eigen::AngleAxisd turn_;               // in the same frame
};

std::vector<Collision> PairMonitor::collisions(const BodySet& bodies) const {
  std::vector<Collision> found;
  for (std::size_t i = 0; i < pairs_.size(); ++i) {
    const auto& a = bodies.body(pairs_[i].first);
    const auto& b = bodies.body(pairs_[i].second);
    const bool apart =
        lower_bound(i, bodies) > 0;  // no surface has passed another one since the bound was made
    if (apart ? !bounds_[i].encloses : boxes_disjoint(a, b)) continue;
    if (const auto depth = collision_depth(a, b)) found.push_back({i, depth->point, depth->depth});
  }
  return found;
}

void PairMonitor::begin(const BodySet& bodies) {
  followed_.clear();
  for (std::size_t i = 0; i < bodies.size(); ++i) followed_.push_back(bodies.body(i).world_from_body);
  travelled_ = 0;
  std::fill(clear_up_to_.begin(), clear_up_to_.end(), 0);
}

std::vector<Collision> PairMonitor::follow(const BodySet& bodies, const Selection& left_out) {
  std::vector<Collision> found;
  double moved = 0;
  for (std::size_t i = 0; i < bodies.size(); ++i) {
    const BodySet::Body& body = bodies.body(i);
    const double by =
        motion_bound(body.shape->centre, body.shape->radius, followed_[i], body.world_from_body);
    moved = std::max(moved, by);
  }
  if (moved == 0) return found;
  travelled_ += 2 * moved;
  for (std::size_t i = 0; i < pairs_.size(); ++i) {
    // The margin allows for bodies that move on curves relative to each other.
    if (left_out[i] || clear_up_to_[i] > travelled_ + kFinest) continue;
    const auto [larger, smaller] = larger_and_smaller(i, bodies);
    const Way way(i, larger, smaller, followed_, bodies);
    const double apart = lower_bound(i, bodies);
    if (apart > way.length()) {
      clear_up_to_[i] = travelled_ + apart;
    } else if (way.length() < kAtRest) {
      continue;
    } else if (const auto collision = collision_on(way, bodies, 0.5, 0.5)) {
      found.push_back(*collision);
    }
  }
  for (std::size_t i = 0; i < bodies.size(); ++i) followed_[i] = bodies.body(i).world_from_body;
  return found;
}

std::optional<Collision> PairMonitor::collision_on(const Way& way, const BodySet& bodies, double middle,
                                                   double half) {
  const double motion = half * way.length();
  const bool near = search_
                        .near(search_body(way.larger, bodies), search_body(way.smaller, bodies),
                              way.larger_from_smaller(middle), motion, memory_[way.pair], 0, kPatience,
                              way.sweep(middle, half))
                        .has_value();
  if (!near) return std::nullopt;
  const auto [larger, smaller] = way.bodies_at(middle);
  if (const auto depth = collision_depth(larger, smaller))
    return Collision{way.pair, depth->point, depth->depth};
  if (2 * motion <= kFinest) return std::nullopt;
  if (const auto earlier = collision_on(way, bodies, middle - half / 2, half / 2)) return earlier;
  return collision_on(way, bodies, middle + half / 2, half / 2);
}

const SearchBody& PairMonitor::search_body(std::size_t body, const BodySet& bodies) {
  search_bodies_.resize(bodies.size());
  auto& made = search_bodies_[body];
  if (!made) made = std::make_shared<const SearchBody>(bodies.body(body).shape);
  return *made;
}

std::pair<std::size_t, std::size_t> PairMonitor::larger_and_smaller(std::size_t pair,
                                                                    const BodySet& bodies) const {
  const auto& [a, b] = pairs_[pair];
  return bodies.body(a).shape->radius < bodies.body(b).shape->radius ? std::pair(b, a) : std::pair(a, b);
}

double PairMonitor::lower_bound(std::size_t pair, const BodySet& bodies) const {
  const auto [larger, smaller] = larger_and_smaller(pair, bodies);
  const Shape& moving = *bodies.body(smaller).shape;
  const Eigen::Isometry3d pose =
      bodies.body(larger).world_from_body.inverse() * bodies.body(smaller).world_from_body;
  return bounds_[pair].lower_bound -
         motion_bound(moving.centre, moving.radius, bounds_[pair].larger_from_smaller, pose);
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
    const double at_least = lower_bound(i, bodies);
    if (at_least > 0 && bounds_[i].encloses) update({i, {0, 0}, 0.0});
    if (at_least >= bound) continue;
    fcl::DistanceResultd result;
    result.min_distance = bound + kSearchMargin;  // the search only looks for smaller distances
    fcl::distance(&a.shape->model, a.world_from_body, &b.shape->model, b.world_from_body,
                  fcl::DistanceRequestd(), result);
    const auto [larger, smaller] = larger_and_smaller(i, bodies);
    bounds_[i] = {bodies.body(larger).world_from_body.inverse() * bodies.body(smaller).world_from_body,
                  result.min_distance, result.min_distance > 0 && one_encloses_other(a, b)};
    const FacePair faces{static_cast<std::size_t>(result.b1), static_cast<std::size_t>(result.b2)};
    update({i, faces, bounds_[i].encloses ? 0.0 : std::max(result.min_distance, 0.0)});
  }
  return found;
}

}  // namespace robotcell::proximity
