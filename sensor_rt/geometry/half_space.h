// Half-spaces, whose intersections bound the regions that light can take.
#pragma once

#include <Eigen/Dense>

namespace sensor_rt {

/// All p with normal · p >= offset.
struct HalfSpace {
  Eigen::Vector3d normal;
  double offset = 0.0;
};

}  // namespace sensor_rt
