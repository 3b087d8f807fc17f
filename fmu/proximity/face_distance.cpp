#include "fmu/proximity/face_distance.h"

#include <fcl/narrowphase/detail/primitive_shape_algorithm/triangle_distance.h>

namespace robotcell::proximity {

FaceDistance face_distance(const Corners& a, const Corners& b, const Eigen::Matrix3d& a_from_b_rotation,
                           const Eigen::Vector3d& a_from_b_translation, double scale) {
  FaceDistance result;
  result.distance = fcl::detail::TriangleDistanced::triDistance(
                        scale * a.a, scale * a.b, scale * a.c, scale * b.a, scale * b.b, scale * b.c,
                        a_from_b_rotation, scale * a_from_b_translation, result.on_a, result.on_b) /
                    scale;
  result.on_a /= scale;
  result.on_b /= scale;
  return result;
}

}  // namespace robotcell::proximity
