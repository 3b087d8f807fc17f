// Convex bodies: penetration depth of points.
#pragma once

#include <Eigen/Core>
#include <dart/dynamics/Shape.hpp>
#include <limits>
#include <optional>
#include <vector>

namespace robotcell {

/// Penetration depth of a point, and the direction of the shortest way out.
struct Depth {
  double depth = 0;
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // outward, in the frame of the solid
};

/// A convex body: an intersection of half-spaces, optionally with a cylinder about the z axis.
class Solid {
 public:
  /// From a box, a cylinder or a convex mesh of the dynamics engine. Throws std::invalid_argument for others.
  explicit Solid(const dart::dynamics::Shape& shape);

  /// Penetration depth of a point in the frame of the shape; empty outside. The surface counts as inside.
  std::optional<Depth> depth(const Eigen::Vector3d& point) const;

 private:
  struct Plane {
    Eigen::Vector3d normal;
    double offset = 0;
  };

  void add_box(const Eigen::Vector3d& half_size);

  std::vector<Plane> planes_;
  double radius_ = std::numeric_limits<double>::infinity();
};

}  // namespace robotcell
