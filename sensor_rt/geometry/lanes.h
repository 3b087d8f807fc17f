// Vectors of 16 rays or points at a time, as structures of arrays.
#pragma once

namespace sensor_rt {

constexpr int kLanes = 16;

struct alignas(64) Lanes3 {
  double x[kLanes];
  double y[kLanes];
  double z[kLanes];
};

}  // namespace sensor_rt
