// Packets of 16 rays as structures of arrays, the unit in which everything is traced.
#pragma once

#include <cstdint>

#include "sensor_rt/geometry/lanes.h"

namespace sensor_rt {

/// Per ray: rotation shape_from_reference (row-major) and the ray's origin in the frame of a shape. The lanes
/// of a packet may lie at different times of an exposure, hence at different poses.
struct alignas(64) LaneTransform {
  double rotation[9][kLanes];
  Lanes3 origin;
};

/// Closest hits so far. t is in units of the ray's direction vector; shape is -1 where nothing was met.
struct alignas(64) PacketHits {
  double t[kLanes];
  Lanes3 normal;  ///< unit, in the reference frame; its sign follows the winding of the face
  std::int32_t shape[kLanes];
  std::uint32_t face[kLanes];
};

}  // namespace sensor_rt
