// Structures of arrays that hold 16 vectors, one per SIMD lane.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cstddef>

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

/// Returns whether a lane of a mask (-1: active, else 0) is active.
inline bool any_lane(const int* mask) {
  return std::any_of(mask, mask + kLanes, [](int lane) { return lane != 0; });
}

/// Activates the first `count` lanes of a mask.
inline void activate_lanes(std::size_t count, int* mask) {
  for (std::size_t l = 0; l < kLanes; ++l) mask[l] = l < count ? -1 : 0;
}

}  // namespace sensor_rt
