// A body as the proximity library sees it.
#pragma once

#include <fcl/geometry/bvh/BVH_model.h>
#include <fcl/math/bv/OBBRSS.h>

#include <memory>

#include "fmu/proximity/body_set.h"

namespace robotcell::proximity {

using Model = fcl::BVHModel<fcl::OBBRSSd>;

struct BodySet::Body {
  TriangleMesh mesh;
  Eigen::AlignedBox3d bounds;  // of the mesh, body frame
  double radius = 0;           // about the body's origin, holds the mesh
  std::shared_ptr<Model> model;
  Eigen::Isometry3d world_from_body = Eigen::Isometry3d::Identity();
};

}  // namespace robotcell::proximity
