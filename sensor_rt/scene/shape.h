// Surface of a body: a triangle mesh or an exact primitive.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cstdint>
#include <memory>
#include <vector>

#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/scene/curved_face.h"
#include "sensor_rt/scene/embree.h"
#include "sensor_rt/scene/material.h"
#include "sensor_rt/scene/mesh_view.h"

namespace sensor_rt {

enum class ShapeKind { kMesh, kSphere, kBox, kFrustum, kRectangle };

/// Cone frustum or cylinder along z with end faces at z = ±half_height, of radius `middle_radius + slope *
/// z`, with a bore through it unless `bore_radius` is 0.
struct Frustum {
  double middle_radius = 0.0;
  double slope = 0.0;
  double half_height = 0.0;
  double bore_radius = 0.0;
};

/// Surface in its own frame, centred in its bounding box to preserve single precision.
struct Shape {
  ShapeKind kind = ShapeKind::kMesh;
  int body = 0;
  double reflectance = 0.0;  ///< directional-hemispherical, at normal incidence
  std::shared_ptr<const Bsdf> surface;
  Grooves grooves;  ///< in the frame of the shape
  Rigid3 shape_from_body;
  /// Half extents of the bounding box. For a sphere, a box and a rectangle, which lies in z = 0, these are
  /// the dimensions.
  Eigen::Vector3d half_size = Eigen::Vector3d::Zero();
  Frustum frustum;                           ///< frusta only
  std::vector<FacePlane> planes;             ///< meshes only, one per face
  std::vector<CurvedFace> curved;            ///< exact surfaces of a mesh from CAD
  std::vector<std::int32_t> curved_of_face;  ///< number in `curved` of each face, -1: flat; empty without any
  SceneHandle embree;                        ///< meshes only

  /// Returns normal and grooves at a point, in the reference frame.
  SurfaceFrame frame(const Rigid3& shape_from_reference, const Eigen::Vector3d& point,
                     const Eigen::Vector3d& normal) const {
    if (grooves.axis.isZero()) return normal;
    const Rigid3 reference_from_shape = shape_from_reference.inverse();
    Eigen::Vector3d along = reference_from_shape.rotation * grooves.axis;
    if (grooves.around) along = along.cross(point - reference_from_shape * grooves.centre);
    along -= along.dot(normal) * normal;
    const double length = along.norm();
    return length > 1e-9 * grooves.axis.norm() ? SurfaceFrame(normal, along / length) : SurfaceFrame(normal);
  }

  /// Returns the distance, m, by which secondary rays start above the surface so as not to hit it again: 1
  /// µm, or some units in the last place of single precision at the rim of a large shape.
  double ray_offset() const { return std::max(1e-6, 1e-6 * half_size.norm()); }
};

}  // namespace sensor_rt
