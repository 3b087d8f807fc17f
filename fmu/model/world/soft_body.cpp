#include "fmu/model/world/soft_body.h"

#include <cmath>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/dynamics/PointMass.hpp>
#include <dart/dynamics/SoftBodyNode.hpp>
#include <dart/dynamics/SoftMeshShape.hpp>
#include <locale>
#include <map>
#include <sstream>
#include <utility>

#include "fmu/model/description/cell_description.h"

namespace robotcell {
namespace {

using namespace dart::dynamics;
using Eigen::Matrix3d;
using Eigen::Vector3d;

/// Fraction of the mass in the surface points; the rest keeps a positive definite inertia for the core.
constexpr double kSurfaceMassFraction = 0.25;

/// Fraction of the theoretical maximum stiffness up to which the engine holds a point in contact.
constexpr double kMaxStiffnessFraction = 0.8;

constexpr std::size_t kMaxPoints = 400;

[[noreturn]] void fail(const PartDescription& part, const std::string& what) {
  throw DescriptionError("part '" + part.name + "': soft" + what);
}

using Edge = std::pair<int, int>;

/// Longest edge, and its length.
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

void split_edge(Hull& hull, const Edge& edge) {
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

/// Inertia of the part minus that of the surface points.
Inertia core_inertia(const PartDescription& part, const Hull& surface) {
  const double point_mass =
      kSurfaceMassFraction * part.inertial.mass / static_cast<double>(surface.vertices.size());
  const auto about = [](double mass, const Vector3d& r) -> Matrix3d {
    return mass * (r.squaredNorm() * Matrix3d::Identity() - r * r.transpose());
  };
  const double mass = (1 - kSurfaceMassFraction) * part.inertial.mass;
  Vector3d moment = part.inertial.mass * part.inertial.centre_of_mass;
  Matrix3d inertia = part.inertial.inertia + about(part.inertial.mass, part.inertial.centre_of_mass);
  for (const Vector3d& point : surface.vertices) {
    moment -= point_mass * point;
    inertia -= about(point_mass, point);
  }
  const Vector3d centre = moment / mass;
  inertia -= about(mass, centre);
  // A valid inertia has principal moments each smaller than the sum of the other two; the matrix of second
  // moments is then positive definite.
  const Matrix3d second_moments = inertia.trace() / 2 * Matrix3d::Identity() - inertia;
  if (second_moments.llt().info() != Eigen::Success) {
    fail(part, ": the inertia is too small for " + std::to_string(kSurfaceMassFraction) +
                   " of the mass in the surface points");
  }
  return {mass, centre, inertia};
}

/// The engine integrates springs and damper implicitly for a free point, but uses the bare mass m for a point
/// in contact, where the effective stiffness is reduced by the factor m / (m + c h + k h^2). The springs are
/// made stiffer by that factor, so that points in contact have the described stiffness.
SoftBodyNode::UniqueProperties spring_properties(const PartDescription& part, double point_mass,
                                                 double time_step) {
  const SoftDescription& soft = *part.soft;
  const double max_stiffness = kMaxStiffnessFraction * point_mass / (time_step * time_step);
  if (soft.stiffness > max_stiffness) {
    std::ostringstream text;
    text.imbue(std::locale::classic());
    text << ".stiffness must be at most " << max_stiffness << " N/m for points of " << point_mass
         << " kg and this time step, not " << soft.stiffness << " N/m";
    fail(part, text.str());
  }
  SoftBodyNode::UniqueProperties properties;
  properties.mKe = 0;
  properties.mDampCoeff = 2 * soft.damping_ratio * std::sqrt(soft.stiffness * point_mass);
  properties.mKv = soft.stiffness * (point_mass + time_step * properties.mDampCoeff) /
                   (point_mass - time_step * time_step * soft.stiffness);
  return properties;
}

}  // namespace

Hull refine(const Hull& hull, double longest_edge) {
  Hull fine = hull;
  for (auto longest = longest_edge_of(fine); longest.second > longest_edge; longest = longest_edge_of(fine)) {
    if (fine.vertices.size() > kMaxPoints) break;
    split_edge(fine, longest.first);
  }
  return fine;
}

SkeletonPtr make_soft_part(const std::string& name, const PartDescription& part, const Hull& hull,
                           double time_step) {
  const Hull surface = refine(hull, part.soft->longest_edge);
  if (surface.vertices.size() > kMaxPoints) {
    fail(part, ".longest_edge = " + std::to_string(part.soft->longest_edge) + " m needs more than " +
                   std::to_string(kMaxPoints) + " points");
  }
  const double point_mass =
      kSurfaceMassFraction * part.inertial.mass / static_cast<double>(surface.vertices.size());
  SoftBodyNode::UniqueProperties soft = spring_properties(part, point_mass, time_step);
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
  node->setInertia(core_inertia(part, surface));
  ShapeNode* shape = soft_surface(node);
  shape->removeAspect<CollisionAspect>();  // only SoftCollisionDetector handles it
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
