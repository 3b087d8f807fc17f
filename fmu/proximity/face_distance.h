// Distance between two triangles.
#pragma once

#include <Eigen/Geometry>

#include "fmu/proximity/triangle.h"

namespace robotcell::proximity {

struct FaceDistance {
  double distance = 0;         // m; 0 where the triangles intersect
  Eigen::Vector3d on_a, on_b;  // closest points, frame of a; undefined where the triangles intersect
};

/// FCL's distance of triangle `b` from triangle `a`, with the points multiplied by `scale` and the result
/// divided.
///
/// FCL treats a triangle as degenerate when twice its area is below 3e-8: in metres that is an edge length of
/// 0.2 mm. `kFine` avoids it and, being a power of two, changes no other result.
FaceDistance face_distance(const Corners& a, const Corners& b, const Eigen::Matrix3d& a_from_b_rotation,
                           const Eigen::Vector3d& a_from_b_translation, double scale = 1);

constexpr double kFine = 1 << 20;

}  // namespace robotcell::proximity
