// Intersection of packets of rays with single shapes.
#pragma once

#include <cstdint>

#include "sensor_rt/scene/shape.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// Resets all lanes to no hit, with the search limit t = `farthest`.
void clear_hits(PacketHits& hits, double farthest);

/// Updates the closest hits with `shape` (index `index`). Directions are in the reference frame and of any
/// length. valid: -1 for active lanes, else 0. Triangles are found in single precision and their planes
/// intersected again in double precision; primitives are exact.
void intersect_shape(const Shape& shape, std::int32_t index, const LaneTransform& transform,
                     const Lanes3& direction, const int* valid, PacketHits& hits);

/// Sets unoccluded[lane] to 0 where the shape intersects the ray at 0 < t < farthest; lanes that are 0 are
/// skipped.
void occlude_by_shape(const Shape& shape, const LaneTransform& transform, const Lanes3& direction,
                      double farthest, int* unoccluded);

}  // namespace sensor_rt
