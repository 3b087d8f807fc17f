// Packets of 16 rays as structures of arrays, the unit of ray tracing.
#pragma once

#include <cstdint>
#include <limits>

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/scene/mesh_view.h"

namespace sensor_rt {

/// t of rays without a hit.
constexpr double kNoHit = std::numeric_limits<double>::infinity();

/// Per ray: rotation shape_from_reference (row-major) and the ray's origin in the frame of a shape. The lanes
/// of a packet may belong to different instants of an exposure, hence to different poses.
struct alignas(64) LaneTransform {
  double rotation[9][kLanes];
  Lanes3 origin;
};

/// Closest hits so far. t is in units of the ray's direction vector; shape is -1 without a hit.
struct alignas(64) PacketHits {
  double t[kLanes];
  Lanes3 normal;  ///< unit, in the reference frame; oriented by the winding of the face
  std::int32_t shape[kLanes];
  std::uint32_t face[kLanes];
};

}  // namespace sensor_rt
