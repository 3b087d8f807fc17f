// Intersection of packets of rays with single shapes.
#pragma once

#include <cstdint>
#include <vector>

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

/// Finds the closest hits with all shapes. `transform_of(s)` returns the LaneTransform of shape s.
template <typename TransformOf>
void intersect_shapes(const std::vector<Shape>& shapes, const TransformOf& transform_of,
                      const Lanes3& direction, const int* valid, PacketHits& hits) {
  clear_hits(hits, kNoHit);
  for (std::size_t s = 0; s < shapes.size(); ++s) {
    intersect_shape(shapes[s], static_cast<std::int32_t>(s), transform_of(s), direction, valid, hits);
  }
}

/// Sets unoccluded[lane] to 0 where a shape intersects the ray at 0 < t < farthest.
template <typename TransformOf>
void occlude_by_shapes(const std::vector<Shape>& shapes, const TransformOf& transform_of,
                       const Lanes3& direction, double farthest, int* unoccluded) {
  for (std::size_t s = 0; s < shapes.size(); ++s) {
    occlude_by_shape(shapes[s], transform_of(s), direction, farthest, unoccluded);
  }
}

}  // namespace sensor_rt
