// Packets of rays against a known piece of surface.
#pragma once

#include "sensor_rt/scene/shape.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// Hits of rays that are known to meet nothing before `patch` of this shape. False when one of them misses
/// the patch; the hits then mean nothing.
bool meet_patch(const Shape& shape, const Patch& patch, const LaneTransform& transform,
                const Lanes3& direction, const int* valid, PacketHits& hits);

}  // namespace sensor_rt
