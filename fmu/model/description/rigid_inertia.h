// Mass properties of a rigid body.
#pragma once

#include <Eigen/Core>

namespace robotcell {

class JsonReader;

struct RigidInertia {
  double mass = 0;                                           // kg
  Eigen::Vector3d centre_of_mass = Eigen::Vector3d::Zero();  // m, body frame
  Eigen::Matrix3d inertia = Eigen::Matrix3d::Zero();         // kg m^2, about the centre of mass, body axes
};

/// Reads the keys "mass", "centre_of_mass" and "inertia"; throws DescriptionError.
RigidInertia parse_inertia(const JsonReader& json);

}  // namespace robotcell
