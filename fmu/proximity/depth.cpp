#include "fmu/proximity/depth.h"

#include <fcl/geometry/shape/sphere.h>
#include <fcl/narrowphase/distance.h>

#include <algorithm>
#include <map>
#include <set>

#include "fmu/proximity/collision_body.h"
#include "fmu/proximity/triangle.h"

namespace robotcell::proximity {
namespace {

using Eigen::Vector3d;

constexpr std::size_t kMaxPoints = 200;  // maximum number of points considered of each body

using Edge = std::pair<int, int>;  // indices of two vertices, the lower first

/// Edges of one body, with the fractions of their length at which they cross the surface of the other.
using Crossings = std::map<Edge, std::vector<double>>;

void add_crossings(const BodySet::Body& of, std::size_t face, const BodySet::Body& with, std::size_t other,
                   Crossings& crossings) {
  const Eigen::Isometry3d with_from_of = with.world_from_body.inverse() * of.world_from_body;
  const auto& numbers = of.shape->mesh.faces[face];
  for (std::size_t i = 0; i < 3; ++i) {
    const Edge edge = std::minmax(numbers[i], numbers[(i + 1) % 3]);
    const Vector3d from = with_from_of * of.shape->mesh.vertices[static_cast<std::size_t>(edge.first)];
    const Vector3d to = with_from_of * of.shape->mesh.vertices[static_cast<std::size_t>(edge.second)];
    std::vector<double>& fractions = crossings[edge];
    const double fraction = intersect_ray(from, to - from, corners(with.shape->mesh, other));
    if (fraction > 0 && fraction < 1) fractions.push_back(fraction);
  }
}

/// End points of the edges, and midpoints of the segments between crossings; body frame.
std::vector<Vector3d> candidates(const BodySet::Body& body, const Crossings& crossings) {
  std::set<int> ends;
  std::vector<Vector3d> points;
  for (const auto& [edge, crossed] : crossings) {
    ends.insert({edge.first, edge.second});
    if (crossed.empty()) continue;
    std::vector<double> cuts = crossed;
    cuts.push_back(0);
    cuts.push_back(1);
    std::sort(cuts.begin(), cuts.end());
    const Vector3d& from = body.shape->mesh.vertices[static_cast<std::size_t>(edge.first)];
    const Vector3d& to = body.shape->mesh.vertices[static_cast<std::size_t>(edge.second)];
    for (std::size_t i = 1; i < cuts.size(); ++i) {
      if (cuts[i] > cuts[i - 1]) points.push_back(from + (cuts[i] + cuts[i - 1]) / 2 * (to - from));
    }
  }
  for (const int end : ends) points.push_back(body.shape->mesh.vertices[static_cast<std::size_t>(end)]);
  return points;
}

double distance_from_surface(const BodySet::Body& body, const Vector3d& point_in_body) {
  constexpr double kSmall = 1e-9;  // the library has no points: a small sphere
  const fcl::Sphered point(kSmall);
  fcl::DistanceResultd result;
  fcl::distance(&point, fcl::Transform3d(Eigen::Translation3d(point_in_body)), &body.shape->model,
                fcl::Transform3d::Identity(), fcl::DistanceRequestd(), result);
  return result.min_distance + kSmall;
}

void update_depth(const BodySet::Body& of, const std::vector<Vector3d>& points, const BodySet::Body& within,
                  Depth& depth) {
  const Eigen::Isometry3d within_from_of = within.world_from_body.inverse() * of.world_from_body;
  const std::size_t stride = points.size() / kMaxPoints + 1;
  for (std::size_t i = 0; i < points.size(); i += stride) {
    const Vector3d point = within_from_of * points[i];
    if (!within.shape->bounds.contains(point) || !contains(within.shape->mesh, point)) continue;
    const double distance = distance_from_surface(within, point);
    if (distance <= depth.depth) continue;
    depth = {distance, within.world_from_body * point};
  }
}

bool has_piece_inside(const BodySet::Body& of, const BodySet::Body& within) {
  const Eigen::Isometry3d within_from_of = within.world_from_body.inverse() * of.world_from_body;
  const auto& points = of.shape->inside.points;
  return std::any_of(points.begin(), points.end(),
                     [&](const Vector3d& point) { return contains(within, within_from_of * point); });
}

}  // namespace

Depth depth_at(const BodySet::Body& a, const BodySet::Body& b, const std::vector<FacePair>& intersections) {
  Crossings of_a, of_b;
  for (const auto& [face_a, face_b] : intersections) {
    add_crossings(a, face_a, b, face_b, of_a);
    add_crossings(b, face_b, a, face_a, of_b);
  }
  Depth depth;
  update_depth(a, candidates(a, of_a), b, depth);
  update_depth(b, candidates(b, of_b), a, depth);
  return depth;
}

bool one_encloses_other(const BodySet::Body& a, const BodySet::Body& b) {
  return has_piece_inside(a, b) || has_piece_inside(b, a);
}

Depth depth_inside(const BodySet::Body& a, const BodySet::Body& b) {
  Depth depth;
  update_depth(a, a.shape->mesh.vertices, b, depth);
  update_depth(b, b.shape->mesh.vertices, a, depth);
  return depth;
}

}  // namespace robotcell::proximity
