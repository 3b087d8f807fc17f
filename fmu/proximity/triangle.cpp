#include "fmu/proximity/triangle.h"

#include <limits>

namespace robotcell::proximity {

using Eigen::Vector3d;

Corners corners(const TriangleMesh& mesh, std::size_t face) {
  const auto& [a, b, c] = mesh.faces[face];
  return {mesh.vertices[static_cast<std::size_t>(a)], mesh.vertices[static_cast<std::size_t>(b)],
          mesh.vertices[static_cast<std::size_t>(c)]};
}

/// Moeller and Trumbore, "Fast, minimum storage ray-triangle intersection", J. Graphics Tools 2 (1997).
double intersect_ray(const Vector3d& origin, const Vector3d& direction, const Corners& triangle) {
  constexpr double kNever = std::numeric_limits<double>::infinity();
  const Vector3d ab = triangle.b - triangle.a;
  const Vector3d ac = triangle.c - triangle.a;
  const Vector3d p = direction.cross(ac);
  const double determinant = ab.dot(p);
  if (determinant == 0) return kNever;
  const Vector3d t = origin - triangle.a;
  const double u = t.dot(p) / determinant;
  if (!(u >= 0 && u <= 1)) return kNever;
  const Vector3d q = t.cross(ab);
  const double v = direction.dot(q) / determinant;
  if (!(v >= 0 && u + v <= 1)) return kNever;
  return ac.dot(q) / determinant;
}

const Vector3d& inside_direction() {
  static const Vector3d direction = Vector3d(0.5377, 0.8339, -0.1241).normalized();
  return direction;
}

bool contains(const TriangleMesh& mesh, const Vector3d& point) {
  bool inside = false;
  for (std::size_t i = 0; i < mesh.faces.size(); ++i) {
    const double distance = intersect_ray(point, inside_direction(), corners(mesh, i));
    if (distance > 0 && distance < std::numeric_limits<double>::infinity()) inside = !inside;
  }
  return inside;
}

}  // namespace robotcell::proximity
