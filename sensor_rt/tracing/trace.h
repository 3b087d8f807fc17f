// Packets of rays against single shapes.
#pragma once

#include <cstdint>

#include "sensor_rt/scene/shape.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// All lanes without a hit, looking up to t = `farthest`.
void clear_hits(PacketHits& hits, double farthest);

/// Replaces the hits of rays that meet `shape` (number `index`) nearer than before. Directions in the
/// reference frame, any length. valid: -1 for lanes in use, else 0. Triangles are found in single precision
/// and their planes met again in double; primitives are exact.
void intersect_shape(const Shape& shape, std::int32_t index, const LaneTransform& transform,
                     const Lanes3& direction, const int* valid, PacketHits& hits);

/// The same with the faces that are met known, and roughly where: t is infinite for lanes without any.
void meet_faces(const Shape& shape, std::int32_t index, const LaneTransform& transform,
                const Lanes3& direction, const std::uint32_t* face, const float* t, PacketHits& hits);

/// Sets open[lane] to 0 where the shape cuts the ray at 0 < t < farthest; lanes with open == 0 are left out.
void occlude_by_shape(const Shape& shape, const LaneTransform& transform, const Lanes3& direction,
                      double farthest, int* open);

}  // namespace sensor_rt
