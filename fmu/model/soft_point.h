// What a world remembers of the surface of a soft part.
#pragma once

#include <Eigen/Core>

namespace robotcell {

/// A point of the surface, in the part's frame.
struct SoftPoint {
  Eigen::Vector3d displacement = Eigen::Vector3d::Zero();  // from where it rests
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
};

}  // namespace robotcell
