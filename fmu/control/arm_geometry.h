// What the controller knows of the arm's geometry, and how it follows poses with it.
#pragma once

#include <Eigen/Geometry>
#include <optional>

#include "fmu/control/axis.h"

namespace robotcell::control {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// The tool at some joint angles.
struct ToolState {
  Eigen::Isometry3d pose;  // world_from_tool
  Matrix6 jacobian;  // rows 1-3: velocity of the tool's origin, 4-6: angular velocity; both in the world
};

/// The nominal geometry that the controller is handed.
class ArmGeometry {
 public:
  virtual ~ArmGeometry() = default;
  virtual ToolState tool(const Axes& position) const = 0;
};

/// Joint rates blow up where the smallest singular value of the Jacobian (rows in m and rad) is below this:
/// with the wrist stretched to within some 0.8 degrees.
constexpr double kSmallestSingularValue = 0.01;

/// Smallest singular value of a Jacobian.
double regularity(const Matrix6& jacobian);

/// Shift and turn (rotation vector, world) that lead from one pose to another.
Vector6 way_between(const Eigen::Isometry3d& from, const Eigen::Isometry3d& to);

/// The pose from which a way leads on, at the share s of it: straight, and turning about a constant axis.
Eigen::Isometry3d along(const Eigen::Isometry3d& from, const Vector6& way, double s);

/// Joint positions (and the Jacobian there) at which the tool takes a pose near the one that it has at
/// `position`: repeated corrections by resolved rate. Empty if they do not lead there.
struct Followed {
  Axes position;
  Matrix6 jacobian;
};
std::optional<Followed> follow(const ArmGeometry& arm, const Eigen::Isometry3d& pose, const Axes& position);

}  // namespace robotcell::control
