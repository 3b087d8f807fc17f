// Representation of a body for the proximity library.
#pragma once

#include <fcl/geometry/bvh/BVH_model.h>
#include <fcl/math/bv/OBBRSS.h>

#include <memory>
#include <vector>

#include "fmu/proximity/body_set.h"

namespace robotcell::proximity {

using Model = fcl::BVHModel<fcl::OBBRSSd>;

/// Interior of a mesh. Vertices at the same position are one.
struct Inside {
  explicit Inside(const TriangleMesh& mesh);

  bool closed = false;                  // every edge belongs to an even number of faces
  std::vector<Eigen::Vector3d> points;  // a vertex of each connected piece, body frame
};

/// Shape of a body: independent of its pose.
struct Shape {
  explicit Shape(TriangleMesh triangles);

  TriangleMesh mesh;
  Inside inside;
  Eigen::AlignedBox3d bounds;  // of the mesh, body frame
  Eigen::Vector3d centre;      // of the bounding sphere, body frame
  double radius = 0;
  Model model;
};

struct BodySet::Body {
  std::shared_ptr<const Shape> shape;
  Eigen::Isometry3d world_from_body = Eigen::Isometry3d::Identity();
};

/// Whether a point (body frame) is inside a body; nothing is inside an open mesh.
bool contains(const BodySet::Body& body, const Eigen::Vector3d& point);

}  // namespace robotcell::proximity
