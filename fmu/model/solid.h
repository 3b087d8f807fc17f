// Convex bodies by their surfaces: how deep a point lies inside.
#pragma once

#include <Eigen/Core>
#include <dart/dynamics/Shape.hpp>
#include <limits>
#include <optional>
#include <vector>

namespace robotcell {

/// How deep a point lies, and which way it gets out soonest.
struct Depth {
  double depth = 0;
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  // outwards, in the frame of the solid
};

/// A convex body: half-spaces, and perhaps a cylinder about its z axis.
class Solid {
 public:
  /// A box, a cylinder or a convex mesh of the dynamics engine. Throws std::invalid_argument for others.
  explicit Solid(const dart::dynamics::Shape& shape);

  /// Nothing where a point, in the frame of the shape, lies outside. The surface counts as inside.
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
