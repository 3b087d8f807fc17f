// Half-spaces. Their intersections are the convex regions that light paths stay in.
#pragma once

#include <Eigen/Dense>

namespace sensor_rt {

/// All points p with normal · p >= offset.
struct HalfSpace {
  Eigen::Vector3d normal;
  double offset = 0.0;
};

}  // namespace sensor_rt
