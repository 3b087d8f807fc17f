// Largest displacement of a body's points between two poses.
#pragma once

#include <Eigen/Geometry>
#include <cmath>

namespace robotcell::proximity {

/// Far above the rounding error of distances, far below any tolerance of the project (m).
constexpr double kRounding = 1e-9;

/// Upper bound (m) on the displacement, between two poses, of all points within `radius` of `centre` (body
/// frame). 0 for equal poses; otherwise it includes a margin for rounding.
inline double motion_bound(const Eigen::Vector3d& centre, double radius, const Eigen::Isometry3d& before,
                           const Eigen::Isometry3d& now) {
  if (before.matrix() == now.matrix()) return 0;
  // The spectral norm of a difference of rotations is its Frobenius norm over the square root of 2.
  const double chord = (now.linear() - before.linear()).norm() / std::sqrt(2.0);
  return (now * centre - before * centre).norm() + chord * radius + kRounding;
}

}  // namespace robotcell::proximity
