// Representation of a body for the proximity library.
#pragma once

#include <fcl/geometry/bvh/BVH_model.h>
#include <fcl/math/bv/OBBRSS.h>

#include <memory>

#include "fmu/proximity/body_set.h"

namespace robotcell::proximity {

using Model = fcl::BVHModel<fcl::OBBRSSd>;

/// Shape of a body: independent of its pose.
struct Shape {
  explicit Shape(TriangleMesh triangles);

  TriangleMesh mesh;
  Eigen::AlignedBox3d bounds;  // of the mesh, body frame
  double radius = 0;           // of the bounding sphere about the body origin
  Model model;
};

struct BodySet::Body {
  std::shared_ptr<const Shape> shape;
  Eigen::Isometry3d world_from_body = Eigen::Isometry3d::Identity();
};

}  // namespace robotcell::proximity
