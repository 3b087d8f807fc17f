// Intersection of packets of rays with a known surface patch.
#pragma once

#include "sensor_rt/scene/shape.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// Computes the hits of rays that are known to hit nothing before `patch` of this shape. Returns false when
/// one of them misses the patch; the hits are then undefined.
bool intersect_patch(const Shape& shape, const Patch& patch, const LaneTransform& transform,
                     const Lanes3& direction, const int* valid, PacketHits& hits);

}  // namespace sensor_rt
