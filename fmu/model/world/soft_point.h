// State of the surface of a soft part.
#pragma once

#include <Eigen/Core>

namespace robotcell {

/// Surface point, in the part frame.
struct SoftPoint {
  Eigen::Vector3d displacement = Eigen::Vector3d::Zero();  // from its rest position
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
};

}  // namespace robotcell
