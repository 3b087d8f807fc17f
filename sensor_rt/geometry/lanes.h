// Structures of arrays that hold 16 vectors, one per SIMD lane.
#pragma once

#include <Eigen/Dense>

namespace sensor_rt {

constexpr int kLanes = 16;

struct alignas(64) Lanes3 {
  double x[kLanes];
  double y[kLanes];
  double z[kLanes];
};

inline Eigen::Vector3d lane(const Lanes3& v, int l) { return {v.x[l], v.y[l], v.z[l]}; }

inline void set_lane(Lanes3& v, int l, const Eigen::Vector3d& value) {
  v.x[l] = value.x();
  v.y[l] = value.y();
  v.z[l] = value.z();
}

}  // namespace sensor_rt
