#include "sensor_rt/scene/cast.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "sensor_rt/geometry/parallel.h"
#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/scene/ray_view.h"
#include "sensor_rt/scene/trace.h"

namespace sensor_rt {
namespace {

Eigen::Vector3d row(const double* values, std::size_t index) {
  return Eigen::Map<const Eigen::Vector3d>(values + 3 * index);
}

void validate_rays(const double* origins, const double* directions, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    const double length = row(directions, i).norm();
    if (!row(origins, i).allFinite() || !std::isfinite(length) || !(length > 0.0)) {
      throw std::invalid_argument("ray " + std::to_string(i) + " is not finite or has no direction");
    }
  }
}

/// Up to 16 rays with origins of their own.
void cast_packet(const Scene& scene, const PoseTrack& track, const double* origins, const double* directions,
                 std::size_t first, int lanes, CastResult& result) {
  Lanes3 direction;
  alignas(64) int valid[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    const Eigen::Vector3d d =
        row(directions, first + static_cast<std::size_t>(std::min(l, lanes - 1))).normalized();
    direction.x[l] = d.x();
    direction.y[l] = d.y();
    direction.z[l] = d.z();
    valid[l] = l < lanes ? -1 : 0;
  }
  PacketHits hits;
  clear_hits(hits, std::numeric_limits<double>::infinity());
  for (std::size_t s = 0; s < scene.shapes().size(); ++s) {
    LaneTransform transform;
    for (int l = 0; l < kLanes; ++l) {
      const std::size_t ray = first + static_cast<std::size_t>(std::min(l, lanes - 1));
      set_lane(transform, l, track.shape_from_reference(s, 0), row(origins, ray));
    }
    intersect_shape(scene.shapes()[s], static_cast<std::int32_t>(s), transform, direction, valid, hits);
  }
  for (int l = 0; l < lanes; ++l) {
    const std::size_t ray = first + static_cast<std::size_t>(l);
    const bool hit = hits.shape[l] >= 0;
    result.distance[ray] = hits.t[l];
    result.body[ray] = hit ? scene.shapes()[static_cast<std::size_t>(hits.shape[l])].body : -1;
    result.face[ray] = hit ? static_cast<std::int64_t>(hits.face[l]) : -1;
  }
}

}  // namespace

CastResult cast_rays(const Scene& scene, const std::vector<Rigid3>& world_from_body, const double* origins,
                     const double* directions, std::size_t count, unsigned threads) {
  if (world_from_body.size() != scene.bodies().size()) {
    throw std::invalid_argument("world_from_body holds " + std::to_string(world_from_body.size()) +
                                " poses for " + std::to_string(scene.bodies().size()) + " bodies");
  }
  validate_rays(origins, directions, count);
  PoseTrack track;
  track.set_still(scene, world_from_body.data());
  CastResult result;
  result.distance.resize(count);
  result.body.resize(count);
  result.face.resize(count);
  constexpr std::size_t kBlock = 64 * kLanes;
  parallel_for((count + kBlock - 1) / kBlock, threads, [&](std::size_t block, unsigned) {
    const std::size_t end = std::min(count, (block + 1) * kBlock);
    for (std::size_t first = block * kBlock; first < end; first += kLanes) {
      const int lanes = static_cast<int>(std::min<std::size_t>(kLanes, end - first));
      cast_packet(scene, track, origins, directions, first, lanes, result);
    }
  });
  return result;
}

}  // namespace sensor_rt
