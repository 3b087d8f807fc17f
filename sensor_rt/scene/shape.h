// One piece of a body's surface: a triangle mesh or an exact primitive.
#pragma once

#include <Eigen/Dense>
#include <cstdint>
#include <memory>
#include <vector>

#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/scene/embree.h"
#include "sensor_rt/scene/facing_tree.h"
#include "sensor_rt/scene/fan_tree.h"
#include "sensor_rt/scene/material.h"
#include "sensor_rt/scene/mesh_view.h"

namespace sensor_rt {

enum class ShapeKind { kMesh, kSphere, kBox, kCylinder, kRectangle };

/// Surface in a frame of its own, centred in the surface's bounding box so that single precision goes far.
struct Shape {
  ShapeKind kind = ShapeKind::kMesh;
  int body = 0;
  double reflectance = 0.0;  ///< at normal incidence, all directions of exit together
  std::shared_ptr<const Reflection> surface;
  Rigid3 shape_from_body;
  /// Half of the bounding box. For primitives this is their size: radius of a sphere; radius, radius and half
  /// the height of a cylinder along z; a rectangle lies in z = 0.
  Eigen::Vector3d half_size = Eigen::Vector3d::Zero();
  std::vector<FacePlane> planes;  ///< meshes only, one per face
  std::vector<float> reach;       ///< meshes only, see flat_reach
  FacingTree facing;              ///< meshes only
  FanTree fan_tree;               ///< fine meshes only
  SceneHandle embree;             ///< meshes only
  /// Embree's own arrays, in the frame of the shape: three indices per face, three coordinates per vertex.
  const std::uint32_t* faces = nullptr;
  const float* vertices = nullptr;
};

}  // namespace sensor_rt
