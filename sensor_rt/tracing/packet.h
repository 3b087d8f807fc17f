// Packets of 16 rays as structures of arrays, the unit in which everything is traced.
#pragma once

#include <cstdint>

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/scene/mesh_view.h"

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

/// One face of one shape; primitives are a face each.
struct FaceId {
  std::int32_t shape = -1;  ///< -1: none
  std::uint32_t face = 0;

  bool operator==(const FaceId& other) const { return shape == other.shape && face == other.face; }
};

/// A piece of surface made of a few faces of one shape, or of so many in one plane that this stands for them.
/// A plane may also stand in for what lies between a few faces.
struct Patch {
  static constexpr int kMost = 4;

  std::int32_t shape = -1;  ///< -1: none
  int count = 0;            ///< 0: the plane stands for all, face[0] is one of them
  std::uint32_t face[kMost] = {};
  bool in_light = false;  ///< all of it known to be free of shadow
  bool is_flat = false;   ///< there is a plane
  FacePlane plane = {};
};

}  // namespace sensor_rt
