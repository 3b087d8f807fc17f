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

constexpr std::size_t kMostPoints = 200;  // of either body that are looked at

using Edge = std::pair<int, int>;  // numbers of two corners, the lower first

/// Edges of one body, each with its crossings of the other's surface: shares of the way along it.
using Crossings = std::map<Edge, std::vector<double>>;

void cross(const BodySet::Body& of, std::size_t face, const BodySet::Body& with, std::size_t other,
           Crossings& crossings) {
  const Eigen::Isometry3d with_from_of = with.world_from_body.inverse() * of.world_from_body;
  const auto& numbers = of.mesh.faces[face];
  for (std::size_t i = 0; i < 3; ++i) {
    const Edge edge = std::minmax(numbers[i], numbers[(i + 1) % 3]);
    const Vector3d from = with_from_of * of.mesh.vertices[static_cast<std::size_t>(edge.first)];
    const Vector3d to = with_from_of * of.mesh.vertices[static_cast<std::size_t>(edge.second)];
    std::vector<double>& shares = crossings[edge];
    const double share = meet(from, to - from, corners(with.mesh, other));
    if (share > 0 && share < 1) shares.push_back(share);
  }
}

/// Ends of the edges, and the middles of the pieces into which the crossings cut them; body frame.
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
    const Vector3d& from = body.mesh.vertices[static_cast<std::size_t>(edge.first)];
    const Vector3d& to = body.mesh.vertices[static_cast<std::size_t>(edge.second)];
    for (std::size_t i = 1; i < cuts.size(); ++i) {
      if (cuts[i] > cuts[i - 1]) points.push_back(from + (cuts[i] + cuts[i - 1]) / 2 * (to - from));
    }
  }
  for (const int end : ends) points.push_back(body.mesh.vertices[static_cast<std::size_t>(end)]);
  return points;
}

double distance_from_surface(const BodySet::Body& body, const Vector3d& point_in_body) {
  constexpr double kSmall = 1e-9;  // the library knows no points
  const fcl::Sphered point(kSmall);
  fcl::DistanceResultd result;
  fcl::distance(&point, fcl::Transform3d(Eigen::Translation3d(point_in_body)), body.model.get(),
                fcl::Transform3d::Identity(), fcl::DistanceRequestd(), result);
  return result.min_distance + kSmall;
}

void deepen(const BodySet::Body& of, const Crossings& crossings, const BodySet::Body& within, Depth& depth) {
  const Eigen::Isometry3d within_from_of = within.world_from_body.inverse() * of.world_from_body;
  const std::vector<Vector3d> points = candidates(of, crossings);
  const std::size_t stride = points.size() / kMostPoints + 1;
  for (std::size_t i = 0; i < points.size(); i += stride) {
    const Vector3d point = within_from_of * points[i];
    if (!within.bounds.contains(point) || !holds(within.mesh, point)) continue;
    const double distance = distance_from_surface(within, point);
    if (distance <= depth.depth) continue;
    depth = {distance, within.world_from_body * point};
  }
}

}  // namespace

Depth depth_at(const BodySet::Body& a, const BodySet::Body& b, const std::vector<FacePair>& intersections) {
  Crossings of_a, of_b;
  for (const auto& [face_a, face_b] : intersections) {
    cross(a, face_a, b, face_b, of_a);
    cross(b, face_b, a, face_a, of_b);
  }
  Depth depth;
  deepen(a, of_a, b, depth);
  deepen(b, of_b, a, depth);
  return depth;
}

}  // namespace robotcell::proximity
