// Ray casting and occlusion queries for arbitrary rays in the world frame.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/large_vector.h"
#include "sensor_rt/scene/scene.h"

namespace sensor_rt {

/// Closest hits: distance along the ray (infinite without a hit), body and face (-1 without a hit; 0 on
/// primitives).
struct CastResult {
  LargeVector<double> distance;
  LargeVector<std::int32_t> body;
  LargeVector<std::int64_t> face;
};

/// Casts `count` rays; origins and directions are (count, 3) in the world frame. Directions need not be unit
/// vectors; distances are in metres regardless. Throws std::invalid_argument for rays that are not finite or
/// have zero direction.
CastResult cast_rays(const Scene& scene, const std::vector<Rigid3>& world_from_body, const double* origins,
                     const double* directions, std::size_t count, unsigned threads);

/// Returns 1 for each of `count` segments from `starts` to `ends`, (count, 3) in the world frame, that is
/// occluded, else 0. Throws std::invalid_argument for segments that are not finite or have zero length.
LargeVector<std::uint8_t> occluded(const Scene& scene, const std::vector<Rigid3>& world_from_body,
                                   const double* starts, const double* ends, std::size_t count,
                                   unsigned threads);

}  // namespace sensor_rt
