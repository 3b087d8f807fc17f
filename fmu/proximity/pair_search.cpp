#include "fmu/proximity/pair_search.h"

#include <algorithm>
#include <limits>

#include "fmu/proximity/face_distance.h"
#include "fmu/proximity/motion_bound.h"

namespace robotcell::proximity {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

/// A pair is searched this many times farther than it moved since its last search, so that the result holds
/// for a few poses.
constexpr double kPosesAhead = 3;

/// Surfaces this close (m) touch: rounding decides whether they intersect.
constexpr double kTouch = 1e-12;

/// A front is built anew from the roots when it has grown by this factor.
constexpr std::size_t kLargestGrowth = 3;

/// Larger fronts are not kept: 1.5 MB per pair.
constexpr std::size_t kLargestFront = 1 << 16;

/// Largest distance beyond the bound that is searched for the sake of later poses (m). Where the pair moves
/// too much for it, and for sweeps, looking ahead costs more than it saves.
constexpr double kFarthestAhead = 0.02;

/// Upper bound on the relative motion of two bodies since the last search.
double relative_motion(const SearchBody& a, const SearchBody& b, const Isometry3d& before,
                       const Isometry3d& now) {
  const BoundingSphere& of_a = a.tree.sphere(0);
  const BoundingSphere& of_b = b.tree.sphere(0);
  return std::min(motion_bound(of_b.centre, of_b.radius, before, now),
                  motion_bound(of_a.centre, of_a.radius, before.inverse(), now.inverse()));
}

}  // namespace

std::optional<ClosestFaces> PairSearch::search(const SearchBody& a, const SearchBody& b,
                                               const Isometry3d& a_from_b, double bound, PairMemory& memory,
                                               double near_enough, std::size_t patience, const Sweep* sweep) {
  double ahead = 0;
  double moved = 0;
  if (memory.at_least >= 0) {
    moved = relative_motion(a, b, memory.a_from_b, a_from_b);
    if (memory.at_least - moved >= bound) return std::nullopt;
    if (!sweep && kPosesAhead * moved <= kFarthestAhead) ahead = kPosesAhead * moved;
  }
  a_ = &a;
  b_ = &b;
  rotation_ = a_from_b.linear();
  translation_ = a_from_b.translation();
  sweep_ = sweep;
  faces_.reset();
  nearest_.reset();
  nearest_distance_ = std::numeric_limits<double>::infinity();
  planes_.reset();
  best_ = bound + ahead;
  bound_ = bound;
  near_enough_ = near_enough;
  patience_ = patience;
  give_up_ = kPatient;
  at_least_ = std::numeric_limits<double>::infinity();
  if (memory.faces) compare(*memory.faces);
  if (faces_ && is_near_enough()) return closest_;  // the memory of an earlier pose stays
  slack_ = ahead;
  begin(moved, memory);
  descend();
  memory.a_from_b = a_from_b;
  // A search that ended early has not ruled out nearer faces.
  memory.at_least = faces_ ? std::min(best_, at_least_) : at_least_;
  if (nearest_) memory.faces = nearest_;
  memory.travelled = travelled_;
  if (front_.size() >= kLargestFront) front_.clear();  // not all of it was stored
  if (travelled_ == 0) memory.first_size = front_.size();
  memory.front.swap(front_);
  if (!faces_ || closest_.distance >= bound) return std::nullopt;
  return closest_;
}

bool PairSearch::encloses(const SearchBody& a, const SearchBody& b, const Isometry3d& a_from_b, double apart,
                          PairMemory& memory) {
  const BoundingSphere &of_a = a.tree.sphere(0), &of_b = b.tree.sphere(0);
  const double between = (a_from_b * of_b.centre - of_a.centre).norm();
  if (between > of_a.radius + of_b.radius) return false;
  // A piece that is inside stays there until the surfaces meet.
  if (relative_motion(a, b, memory.enclosure_at, a_from_b) < memory.enclosure_holds) return memory.encloses;
  const auto has_piece_inside = [this](const SearchBody& of, const SearchBody& within,
                                       const Isometry3d& within_from_of) {
    if (!within.shape->inside.closed) return false;
    const auto& points = of.shape->inside.points;
    return std::any_of(points.begin(), points.end(),
                       [&](const Vector3d& point) { return is_inside(within_from_of * point, within); });
  };
  memory.enclosure_at = a_from_b;
  memory.enclosure_holds = apart;
  memory.encloses =
      has_piece_inside(b, a, a_from_b) || has_piece_inside(a, b, a_from_b.inverse(Eigen::Isometry));
  return memory.encloses;
}

/// Whether a point (body frame) is inside a closed mesh: as `contains`, by the faces near the ray.
bool PairSearch::is_inside(const Vector3d& point, const SearchBody& body) {
  const Shape& shape = *body.shape;
  if (!shape.bounds.contains(point)) return false;
  bool inside = false;
  std::vector<int> nodes{0};
  while (!nodes.empty()) {
    const int node = nodes.back();
    nodes.pop_back();
    ++work_;
    const BoundingSphere& sphere = body.tree.sphere(node);
    const Vector3d to_centre = sphere.centre - point;
    const double radius = sphere.radius + kRounding;
    if (to_centre.dot(inside_direction()) < -radius) continue;
    if (to_centre.cross(inside_direction()).squaredNorm() > radius * radius) continue;
    if (body.tree.is_leaf(node)) {
      const double distance =
          intersect_ray(point, inside_direction(), corners(shape.mesh, body.tree.face(node)));
      if (distance > 0 && distance < std::numeric_limits<double>::infinity()) inside = !inside;
    } else {
      nodes.push_back(body.tree.first_child(node));
      nodes.push_back(body.tree.first_child(node) + 1);
    }
  }
  return inside;
}

/// Puts the nodes to search on the stack: those of the last front that may have come near enough since, or
/// the roots.
void PairSearch::begin(double moved, PairMemory& memory) {
  stack_.clear();
  front_.clear();
  if (memory.front.empty() || memory.front.size() > kLargestGrowth * memory.first_size) {
    travelled_ = 0;
    visit(0, 0);
    return;
  }
  travelled_ = memory.travelled + moved;
  for (const FrontNode& node : memory.front) {
    const double at_least = node.at_least - travelled_;
    if (at_least >= limit()) {
      at_least_ = std::min(at_least_, at_least);
      front_.push_back(node);
    } else {
      visit(node.a, node.b);
    }
  }
}

void PairSearch::leave_out(double at_least, int node_a, int node_b) {
  at_least_ = std::min(at_least_, at_least);
  if (front_.size() < kLargestFront) front_.push_back({at_least + travelled_, node_a, node_b});
}

void PairSearch::descend() {
  while (!stack_.empty() && !is_near_enough()) {
    const Node node = stack_.back();
    stack_.pop_back();
    if (node.at_least >= limit()) {
      leave_out(node.at_least, node.a, node.b);
      continue;
    }
    const BoundingTree& a = a_->tree;
    const BoundingTree& b = b_->tree;
    if (a.is_leaf(node.a) && b.is_leaf(node.b)) {
      leave_out(compare({a.face(node.a), b.face(node.b)}), node.a, node.b);
      continue;
    }
    const std::size_t first = stack_.size();
    if (split_first(node)) {
      visit(a.first_child(node.a), node.b);
      visit(a.first_child(node.a) + 1, node.b);
    } else {
      visit(node.a, b.first_child(node.b));
      visit(node.a, b.first_child(node.b) + 1);
    }
    // The nearer one is next.
    if (stack_.size() == first + 2 && stack_[first].at_least < stack_[first + 1].at_least) {
      std::swap(stack_[first], stack_[first + 1]);
    }
  }
  for (const Node& node : stack_) leave_out(node.at_least, node.a, node.b);
}

void PairSearch::visit(int node_a, int node_b) {
  ++work_;
  const NodeDistance found = distance_bound(node_a, node_b);
  if (found.at_least < limit() && !found.stays_clear) {
    stack_.push_back({found.at_least, node_a, node_b});
  } else {
    leave_out(found.at_least, node_a, node_b);
  }
}

PairSearch::NodeDistance PairSearch::distance_bound(int node_a, int node_b) const {
  const BoundingSphere& sphere_a = a_->tree.sphere(node_a);
  const BoundingSphere& sphere_b = b_->tree.sphere(node_b);
  const Vector3d between = rotation_ * sphere_b.centre + translation_ - sphere_a.centre;
  const double by_spheres = between.norm() - sphere_a.radius - sphere_b.radius;
  const double enough = limit() + slack_;
  if (by_spheres >= enough) return {by_spheres, false};
  const BoundingBox& box_a = a_->tree.box(node_a);
  const BoundingBox& box_b = b_->tree.box(node_b);
  const auto stays_clear_along = [&](const Vector3d& normal, double gap) {
    if (!sweep_ || gap < sweep_->clearance) return false;
    return sweep_->of_first ? stays_clear(normal, gap, sphere_a.centre, sphere_a.radius)
                            : stays_clear(normal, gap, sphere_a.centre + between, sphere_b.radius);
  };
  double at_least = by_spheres;
  if (planes_) {
    const double by_planes = planes_->normal_in_a.dot(between) - box_a.half_extent(planes_->normal_in_a) -
                             box_b.half_extent(planes_->normal_in_b);
    at_least = std::max(at_least, by_planes);
    if (by_planes >= enough) return {at_least, false};
    if (stays_clear_along(planes_->normal_in_a, by_planes)) return {at_least, true};
  }
  const Vector3d gap = box_gap(box_a, box_b, rotation_, between, enough);
  const double by_boxes = gap.norm();
  return {std::max(at_least, by_boxes), by_boxes > 0 && stays_clear_along(gap / by_boxes, by_boxes)};
}

/// Whether points in a ball, `gap` away from the other body's along a unit vector, keep the clearance of the
/// sweep.
bool PairSearch::stays_clear(const Vector3d& normal, double gap, const Vector3d& centre,
                             double radius) const {
  const double turned = normal.cross(sweep_->turn).norm() * radius;
  return gap - std::abs(normal.dot(sweep_->motion(centre))) - turned >= sweep_->clearance;
}

/// Whether the sweep is proved to bring no points of two faces nearer, along a unit vector, than its
/// clearance.
bool PairSearch::stays_clear(const Corners& a, const Corners& b, const Vector3d& normal) const {
  const auto swept = [&](const Vector3d& point) { return std::abs(normal.dot(sweep_->motion(point))); };
  double lowest = std::numeric_limits<double>::infinity(), highest = -lowest;
  for (const Vector3d& point : {a.a, a.b, a.c}) {
    highest = std::max(highest, normal.dot(point) + (sweep_->of_first ? swept(point) : 0));
  }
  for (const Vector3d& in_b : {b.a, b.b, b.c}) {
    const Vector3d point = rotation_ * in_b + translation_;
    lowest = std::min(lowest, normal.dot(point) - (sweep_->of_first ? 0 : swept(point)));
  }
  return lowest - highest >= sweep_->clearance;
}

/// Whether to split the node of the first body. Where planes may separate children of the nodes it is the one
/// that reaches farther across them, with its motion in the sweep; else the larger one.
bool PairSearch::split_first(const Node& node) const {
  const BoundingTree& a = a_->tree;
  const BoundingTree& b = b_->tree;
  if (a.is_leaf(node.a) || b.is_leaf(node.b)) return b.is_leaf(node.b);
  if (planes_) {
    const Vector3d& normal = planes_->normal_in_a;
    const Vector3d& centre_a = a.sphere(node.a).centre;
    const Vector3d centre_b = rotation_ * b.sphere(node.b).centre + translation_;
    double gap = normal.dot(centre_b - centre_a), needed = limit();
    double of_a = a.box(node.a).half_extent(normal), of_b = b.box(node.b).half_extent(planes_->normal_in_b);
    if (sweep_) {
      const double swept = normal.cross(sweep_->turn).norm();
      (sweep_->of_first ? of_a : of_b) +=
          swept * (sweep_->of_first ? a.sphere(node.a) : b.sphere(node.b)).radius;
      gap -= std::abs(normal.dot(sweep_->motion(sweep_->of_first ? centre_a : centre_b)));
      needed = sweep_->clearance;
    }
    if (gap >= needed) return of_a > of_b;
  }
  return a.sphere(node.a).radius > b.sphere(node.b).radius;
}

/// Distance of two faces, which become the closest ones if it is below all others and the sweep is not proved
/// to keep its clearance.
double PairSearch::compare(const FacePair& faces) {
  ++work_;
  const Corners of_a = corners(a_->shape->mesh, faces.first), of_b = corners(b_->shape->mesh, faces.second);
  const FaceDistance found = face_distance(of_a, of_b, rotation_, translation_, kFine);
  if (!sweep_ && !(found.distance < best_)) return found.distance;
  const bool touches = found.distance < kTouch;
  const Vector3d normal = touches ? Vector3d::Zero() : Vector3d((found.on_b - found.on_a).normalized());
  if (found.distance < nearest_distance_) {
    nearest_ = faces;
    nearest_distance_ = found.distance;
    if (!touches) {
      planes_ = Planes{normal, rotation_.transpose() * normal};
    }
  }
  if (!(found.distance < best_)) return found.distance;
  if (sweep_ && stays_clear(of_a, of_b, normal)) return found.distance;
  if (give_up_ == kPatient && found.distance < bound_) give_up_ = work_ + patience_;
  best_ = touches ? 0 : found.distance;
  faces_ = faces;
  closest_ = {best_, found.on_a, found.on_b};
  return best_;
}

}  // namespace robotcell::proximity
