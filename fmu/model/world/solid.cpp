#include "fmu/model/world/solid.h"

#include <assimp/scene.h>

#include <dart/dynamics/BoxShape.hpp>
#include <dart/dynamics/CylinderShape.hpp>
#include <dart/dynamics/MeshShape.hpp>
#include <stdexcept>

namespace robotcell {
namespace {

using Eigen::Vector3d;

Vector3d corner(const aiMesh& mesh, const aiFace& face, unsigned number) {
  const aiVector3D& v = mesh.mVertices[face.mIndices[number]];
  return {v.x, v.y, v.z};
}

}  // namespace

Solid::Solid(const dart::dynamics::Shape& shape) {
  if (const auto* box = dynamic_cast<const dart::dynamics::BoxShape*>(&shape)) {
    add_box(box->getSize() / 2);
  } else if (const auto* cylinder = dynamic_cast<const dart::dynamics::CylinderShape*>(&shape)) {
    radius_ = cylinder->getRadius();
    for (const double side : {1.0, -1.0}) {
      planes_.push_back({side * Vector3d::UnitZ(), cylinder->getHeight() / 2});
    }
  } else if (const auto* hull = dynamic_cast<const dart::dynamics::MeshShape*>(&shape)) {
    const aiMesh& mesh = *hull->getMesh()->mMeshes[0];
    for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
      const Vector3d a = corner(mesh, mesh.mFaces[f], 0);
      const Vector3d normal =
          (corner(mesh, mesh.mFaces[f], 1) - a).cross(corner(mesh, mesh.mFaces[f], 2) - a).normalized();
      planes_.push_back({normal, normal.dot(a)});
    }
  } else {
    throw std::invalid_argument("contact of soft parts: expected a box, cylinder or mesh, got " +
                                shape.getType());
  }
}

void Solid::add_box(const Vector3d& half_size) {
  for (int axis = 0; axis < 3; ++axis) {
    for (const double side : {1.0, -1.0}) planes_.push_back({side * Vector3d::Unit(axis), half_size[axis]});
  }
}

std::optional<Depth> Solid::depth(const Vector3d& point) const {
  Depth nearest{std::numeric_limits<double>::infinity(), Vector3d::UnitZ()};
  for (const Plane& plane : planes_) {
    const double depth = plane.offset - plane.normal.dot(point);
    if (depth < 0) return std::nullopt;
    if (depth < nearest.depth) nearest = {depth, plane.normal};
  }
  const double distance = point.head<2>().norm();
  if (distance > radius_) return std::nullopt;
  if (radius_ - distance < nearest.depth) {
    nearest = {radius_ - distance, Vector3d(point.x(), point.y(), 0) / distance};
  }
  return nearest;
}

}  // namespace robotcell
