#include "fmu/proximity/body_set.h"

#include <fcl/geometry/shape/box.h>
#include <fcl/narrowphase/collision.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <stdexcept>

#include "fmu/proximity/collision_body.h"
#include "fmu/proximity/triangle.h"

namespace robotcell::proximity {
namespace {

using Eigen::Vector3d;

bool equal(const TriangleMesh& a, const TriangleMesh& b) {
  return a.vertices == b.vertices && a.faces == b.faces;
}

bool crosses(const Eigen::AlignedBox3d& box, const Vector3d& origin, const Vector3d& direction,
             double nearest, double farthest) {
  for (int i = 0; i < 3; ++i) {
    const double t1 = (box.min()[i] - origin[i]) / direction[i];
    const double t2 = (box.max()[i] - origin[i]) / direction[i];
    if (std::isnan(t1) || std::isnan(t2)) {
      continue;  // parallel to and in the plane of a face: the other axes decide
    }
    nearest = std::max(nearest, std::min(t1, t2));
    farthest = std::min(farthest, std::max(t1, t2));
  }
  return nearest <= farthest;
}

}  // namespace

Shape::Shape(TriangleMesh triangles) : mesh(std::move(triangles)), inside(mesh) {
  for (const Vector3d& vertex : mesh.vertices) bounds.extend(vertex);
  centre = bounds.center();
  for (const Vector3d& vertex : mesh.vertices) radius = std::max(radius, (vertex - centre).norm());
  std::vector<fcl::Triangle> faces;
  faces.reserve(mesh.faces.size());
  for (const auto& face : mesh.faces) {
    faces.emplace_back(static_cast<std::size_t>(face[0]), static_cast<std::size_t>(face[1]),
                       static_cast<std::size_t>(face[2]));
  }
  model.beginModel(static_cast<int>(mesh.faces.size()), static_cast<int>(mesh.vertices.size()));
  model.addSubModel(mesh.vertices, faces);
  if (model.endModel() != fcl::BVH_OK) {
    throw std::invalid_argument("the proximity library rejected a body mesh of " +
                                std::to_string(mesh.faces.size()) + " faces");
  }
}

Inside::Inside(const TriangleMesh& mesh) {
  const auto before = [](const Vector3d& a, const Vector3d& b) {
    return std::lexicographical_compare(a.begin(), a.end(), b.begin(), b.end());
  };
  std::map<Vector3d, std::size_t, decltype(before)> places(before);
  std::vector<std::size_t> place_of;
  for (const Vector3d& vertex : mesh.vertices)
    place_of.push_back(places.emplace(vertex, places.size()).first->second);
  std::vector<std::size_t> piece(places.size());  // a position of the same piece; itself for the first one
  std::iota(piece.begin(), piece.end(), 0);
  const auto first_of = [&piece](std::size_t place) {
    while (piece[place] != place) place = piece[place] = piece[piece[place]];
    return place;
  };
  std::map<std::pair<std::size_t, std::size_t>, int> faces_of_edge;
  for (const auto& face : mesh.faces) {
    for (std::size_t i = 0; i < 3; ++i) {
      const std::size_t a = place_of[static_cast<std::size_t>(face[i])];
      const std::size_t b = place_of[static_cast<std::size_t>(face[(i + 1) % 3])];
      if (a == b) continue;  // of a face without area
      ++faces_of_edge[std::minmax(a, b)];
      piece[first_of(a)] = first_of(b);
    }
  }
  closed = std::all_of(faces_of_edge.begin(), faces_of_edge.end(),
                       [](const auto& e) { return e.second % 2 == 0; });
  std::vector<bool> seen(places.size(), false);
  for (const auto& face : mesh.faces) {
    const auto vertex = static_cast<std::size_t>(face[0]);
    const std::size_t first = first_of(place_of[vertex]);
    if (!seen[first]) points.push_back(mesh.vertices[vertex]);
    seen[first] = true;
  }
}

bool contains(const BodySet::Body& body, const Vector3d& point) {
  return body.shape->inside.closed && body.shape->bounds.contains(point) && contains(body.shape->mesh, point);
}

BodySet::BodySet(std::vector<TriangleMesh> meshes, const BodySet* known) {
  for (TriangleMesh& mesh : meshes) {
    Body body;
    for (std::size_t i = 0; known != nullptr && !body.shape && i < known->size(); ++i) {
      if (equal(known->bodies_[i].shape->mesh, mesh)) body = known->bodies_[i];
    }
    if (!body.shape) body.shape = std::make_shared<Shape>(std::move(mesh));
    body.world_from_body = Eigen::Isometry3d::Identity();
    bodies_.push_back(body);
  }
}

BodySet::~BodySet() = default;
BodySet::BodySet(const BodySet&) = default;
BodySet::BodySet(BodySet&&) noexcept = default;

std::size_t BodySet::size() const { return bodies_.size(); }

const BodySet::Body& BodySet::body(std::size_t number) const { return bodies_[number]; }

void BodySet::set_pose(std::size_t body, const Eigen::Isometry3d& world_from_body) {
  bodies_[body].world_from_body = world_from_body;
}

std::optional<RayHit> BodySet::cast_ray(const Vector3d& origin, const Vector3d& direction, double nearest,
                                        double farthest, const Selection& selection) const {
  std::optional<RayHit> hit;
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    if (!selection[i]) continue;
    const Body& body = bodies_[i];
    const Eigen::Isometry3d body_from_world = body.world_from_body.inverse();
    const Vector3d from = body_from_world * origin;
    const Vector3d along = body_from_world.linear() * direction;
    if (!crosses(body.shape->bounds, from, along, nearest, farthest)) continue;
    for (std::size_t face = 0; face < body.shape->mesh.faces.size(); ++face) {
      const double distance = intersect_ray(from, along, corners(body.shape->mesh, face));
      if (!(distance >= nearest && distance <= farthest)) continue;
      farthest = distance;
      hit = RayHit{i, distance};
    }
  }
  return hit;
}

bool BodySet::intersects_box(std::size_t number, const Eigen::Isometry3d& world_from_box,
                             const Vector3d& size) const {
  const Body& body = bodies_[number];
  const Eigen::Isometry3d body_from_box = body.world_from_body.inverse() * world_from_box;
  const Eigen::AlignedBox3d box(-size / 2, size / 2);
  if (!box.transformed(body_from_box).intersects(body.shape->bounds)) return false;
  const fcl::Boxd shape(size);
  fcl::CollisionResultd result;
  fcl::collide(&shape, body_from_box, &body.shape->model, fcl::Transform3d::Identity(),
               fcl::CollisionRequestd(), result);
  if (result.isCollision()) return true;
  // The surface does not intersect the box, which is therefore entirely inside or outside the body.
  return contains(body, body_from_box.translation());
}

}  // namespace robotcell::proximity
