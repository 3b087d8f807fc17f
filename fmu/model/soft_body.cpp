#include "fmu/model/soft_body.h"

#include <cmath>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/dynamics/PointMass.hpp>
#include <dart/dynamics/SoftBodyNode.hpp>
#include <dart/dynamics/SoftMeshShape.hpp>
#include <map>
#include <utility>

#include "fmu/model/cell_description.h"

namespace robotcell {
namespace {

using namespace dart::dynamics;
using Eigen::Matrix3d;
using Eigen::Vector3d;

/// Share of a part's mass in the points of its surface: the core must keep an inertia of its own.
constexpr double kPointShare = 0.25;

/// Share of the stiffness beyond which the engine cannot hold a point in contact.
constexpr double kStiffestShare = 0.8;

constexpr std::size_t kMostPoints = 400;

[[noreturn]] void refuse(const PartDescription& part, const std::string& what) {
  throw DescriptionError("part '" + part.name + "': soft" + what);
}

using Edge = std::pair<int, int>;

/// The longest edge, and its length.
std::pair<Edge, double> longest_edge_of(const Hull& hull) {
  std::pair<Edge, double> longest{{0, 0}, 0};
  for (const auto& face : hull.faces) {
    for (std::size_t k = 0; k < 3; ++k) {
      const int a = face[k], b = face[(k + 1) % 3];
      const double length =
          (hull.vertices[static_cast<std::size_t>(a)] - hull.vertices[static_cast<std::size_t>(b)]).norm();
      if (length > longest.second) longest = {{a, b}, length};
    }
  }
  return longest;
}

void halve(Hull& hull, const Edge& edge) {
  const auto middle = static_cast<int>(hull.vertices.size());
  hull.vertices.push_back((hull.vertices[static_cast<std::size_t>(edge.first)] +
                           hull.vertices[static_cast<std::size_t>(edge.second)]) /
                          2);
  const std::size_t faces = hull.faces.size();
  for (std::size_t f = 0; f < faces; ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      const auto [a, b] = std::minmax(hull.faces[f][k], hull.faces[f][(k + 1) % 3]);
      if (a != std::min(edge.first, edge.second) || b != std::max(edge.first, edge.second)) continue;
      std::array<int, 3> second = hull.faces[f];
      hull.faces[f][(k + 1) % 3] = middle;
      second[k] = middle;
      hull.faces.push_back(second);
      break;
    }
  }
}

/// What the points leave to the core of a part's inertia.
Inertia core_of(const PartDescription& part, const Hull& surface) {
  const double point_mass = kPointShare * part.mass / static_cast<double>(surface.vertices.size());
  const auto about = [](double mass, const Vector3d& r) -> Matrix3d {
    return mass * (r.squaredNorm() * Matrix3d::Identity() - r * r.transpose());
  };
  const double mass = (1 - kPointShare) * part.mass;
  Vector3d moment = part.mass * part.centre_of_mass;
  Matrix3d inertia = part.inertia + about(part.mass, part.centre_of_mass);
  for (const Vector3d& point : surface.vertices) {
    moment -= point_mass * point;
    inertia -= about(point_mass, point);
  }
  const Vector3d centre = moment / mass;
  inertia -= about(mass, centre);
  // Each principal moment must be smaller than the sum of the others: the matrix of second moments is then
  // positive definite.
  const Matrix3d second_moments = inertia.trace() / 2 * Matrix3d::Identity() - inertia;
  if (second_moments.llt().info() != Eigen::Success) {
    refuse(part, ": the mass lies too near the middle to leave " + std::to_string(kPointShare) +
                     " of it to the points of the surface");
  }
  return {mass, centre, inertia};
}

/// The engine lets a point that is free feel springs and damper implicitly, at the end of the step, but one
/// that a contact holds with its bare mass m: there a spring pushes with m / (m + c h + k h^2) of its force.
/// Springs are made that much stronger, so that it is the contacts where they have the described stiffness.
SoftBodyNode::UniqueProperties springs(const PartDescription& part, double point_mass, double time_step) {
  const SoftDescription& soft = *part.soft;
  const double stiffest = kStiffestShare * point_mass / (time_step * time_step);
  if (soft.stiffness > stiffest) {
    refuse(part, ".stiffness must be at most " + std::to_string(stiffest) + " N/m for points of " +
                     std::to_string(point_mass) + " kg and this time step, not " +
                     std::to_string(soft.stiffness));
  }
  SoftBodyNode::UniqueProperties properties;
  properties.mKe = 0;
  properties.mDampCoeff = 2 * soft.damping_ratio * std::sqrt(soft.stiffness * point_mass);
  properties.mKv = soft.stiffness * (point_mass + time_step * properties.mDampCoeff) /
                   (point_mass - time_step * time_step * soft.stiffness);
  return properties;
}

}  // namespace

Hull refined(const Hull& hull, double longest_edge) {
  Hull fine = hull;
  for (auto longest = longest_edge_of(fine); longest.second > longest_edge; longest = longest_edge_of(fine)) {
    if (fine.vertices.size() > kMostPoints) break;
    halve(fine, longest.first);
  }
  return fine;
}

SkeletonPtr make_soft_part(const std::string& name, const PartDescription& part, const Hull& hull,
                           double time_step) {
  const Hull surface = refined(hull, part.soft->longest_edge);
  if (surface.vertices.size() > kMostPoints) {
    refuse(part, ".longest_edge = " + std::to_string(part.soft->longest_edge) + " m makes more than " +
                     std::to_string(kMostPoints) + " points");
  }
  const double point_mass = kPointShare * part.mass / static_cast<double>(surface.vertices.size());
  SoftBodyNode::UniqueProperties soft = springs(part, point_mass, time_step);
  for (const Vector3d& vertex : surface.vertices) {
    soft.addPointMass(PointMass::Properties(vertex, point_mass));
  }
  for (const auto& face : surface.faces) soft.addFace({face[0], face[1], face[2]});
  BodyNode::Properties body(BodyNode::AspectProperties("body"));
  SkeletonPtr skeleton = Skeleton::create(name);
  SoftBodyNode* node = skeleton
                           ->createJointAndBodyNodePair<FreeJoint, SoftBodyNode>(
                               nullptr, FreeJoint::Properties(), SoftBodyNode::Properties(body, soft))
                           .second;
  node->setInertia(core_of(part, surface));
  ShapeNode* shape = soft_surface(node);
  shape->removeAspect<CollisionAspect>();  // only the detector of soft parts knows it
  shape->getDynamicsAspect()->setFrictionCoeff(part.friction);
  return skeleton;
}

ShapeNode* soft_surface(BodyNode* body) { return body->getShapeNode(0); }

std::vector<SoftPoint> soft_points(const BodyNode* body) {
  std::vector<SoftPoint> points;
  const SoftBodyNode* soft = body->asSoftBodyNode();
  if (soft == nullptr) return points;
  for (const PointMass* point : soft->getPointMasses()) {
    points.push_back({point->getPositions(), point->getVelocities()});
  }
  return points;
}

void restore_soft_points(BodyNode* body, const std::vector<SoftPoint>& points) {
  for (std::size_t i = 0; i < points.size(); ++i) {
    PointMass* point = body->asSoftBodyNode()->getPointMass(i);
    point->setPositions(points[i].displacement);
    point->setVelocities(points[i].velocity);
  }
}

}  // namespace robotcell
