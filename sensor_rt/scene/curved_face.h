// Exact surfaces of the faces of a CAD part, of which a mesh holds the triangles.
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <cstdint>

#include "sensor_rt/geometry/rigid3.h"

namespace sensor_rt {

enum class CurvedKind : std::uint8_t { kCylinder, kCone, kSphere, kTorus };

/// Untrimmed surface in its own frame: about its z axis, and a sphere about the origin.
struct CurvedFace {
  CurvedKind kind = CurvedKind::kSphere;
  Rigid3 face_from_shape;
  double radius = 0.0;  ///< of a cone where z = 0; of the centre line of a torus
  double second =
      0.0;  ///< half angle of a cone, rad, positive where it widens along z; radius of the tube of a torus

  /// Returns the signed distance of a point from the surface, m, positive away from the axis (from the
  /// centre, from the centre line), and its gradient, a unit vector; both in the frame of the shape.
  double distance(const Eigen::Vector3d& in_shape, Eigen::Vector3d& gradient) const {
    const Eigen::Vector3d p = face_from_shape * in_shape;
    Eigen::Vector3d out = Eigen::Vector3d::UnitZ();
    double result = 0.0;
    const double across = std::hypot(p.x(), p.y());
    const Eigen::Vector3d radial =
        across > 0.0 ? Eigen::Vector3d(p.x() / across, p.y() / across, 0.0) : Eigen::Vector3d::UnitX();
    switch (kind) {
      case CurvedKind::kCylinder:
        out = radial;
        result = across - radius;
        break;
      case CurvedKind::kCone:
        out = std::cos(second) * radial - std::sin(second) * Eigen::Vector3d::UnitZ();
        result = std::cos(second) * (across - radius) - std::sin(second) * p.z();
        break;
      case CurvedKind::kSphere: {
        const double length = p.norm();
        out = length > 0.0 ? Eigen::Vector3d(p / length) : Eigen::Vector3d::UnitZ();
        result = length - radius;
        break;
      }
      case CurvedKind::kTorus: {
        const double beside = across - radius;
        const double length = std::hypot(beside, p.z());
        out = length > 0.0 ? Eigen::Vector3d((beside * radial + p.z() * Eigen::Vector3d::UnitZ()) / length)
                           : radial;
        result = length - second;
        break;
      }
    }
    gradient = face_from_shape.rotation.transpose() * out;
    return result;
  }
};

}  // namespace sensor_rt
