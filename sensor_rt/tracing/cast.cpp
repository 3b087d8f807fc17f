#include "sensor_rt/tracing/cast.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <stdexcept>
#include <string>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/geometry/parallel.h"
#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/tracing/lane_planes.h"
#include "sensor_rt/tracing/ray_view.h"
#include "sensor_rt/tracing/trace.h"

namespace sensor_rt {
namespace {

/// Returns true for finite values with a non-zero direction. Sums of non-finite values stay non-finite, or
/// become so when multiplied by 0.
inline bool is_ray(double length2, double x, double y, double z) {
  return (length2 > 0.0) & (0.0 * (length2 + x + y + z) == 0.0);
}

/// Throws an exception that names the first invalid ray; its direction is `ends` minus the origin where
/// `to_ends`.
[[noreturn]] void reject(const double* origins, const double* ends, bool to_ends) {
  for (std::size_t i = 0;; ++i) {
    const Eigen::Map<const Eigen::Vector3d> o(origins + 3 * i);
    Eigen::Vector3d d = Eigen::Map<const Eigen::Vector3d>(ends + 3 * i);
    if (to_ends) d -= o;
    if (is_ray(d.squaredNorm(), o.x(), o.y(), o.z())) continue;
    throw std::invalid_argument("ray " + std::to_string(i) + " is not finite or has no direction");
  }
}

/// Loads rows of three values; lanes past the end repeat the last row.
void load(const double* rows, int lanes, Lanes3& out) {
  for (int l = 0; l < lanes; ++l) set_lane(out, l, Eigen::Map<const Eigen::Vector3d>(rows + 3 * l));
  for (int l = lanes; l < kLanes; ++l) set_lane(out, l, lane(out, lanes - 1));
}

/// Converts end points to directions from the origins. False when a ray is not finite or has zero length.
SENSOR_RT_MULTIVERSION
bool to_directions(const Lanes3& __restrict origin, Lanes3& __restrict end) {
  alignas(64) int bad[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    end.x[l] -= origin.x[l];
    end.y[l] -= origin.y[l];
    end.z[l] -= origin.z[l];
    const double length2 = end.x[l] * end.x[l] + end.y[l] * end.y[l] + end.z[l] * end.z[l];
    bad[l] = is_ray(length2, origin.x[l], origin.y[l], origin.z[l]) ? 0 : 1;
  }
  int any = 0;
  for (int l = 0; l < kLanes; ++l) any |= bad[l];
  return any == 0;
}

/// Normalises directions. False when a ray is not finite or has zero direction.
SENSOR_RT_MULTIVERSION
bool normalize(const Lanes3& __restrict origin, Lanes3& __restrict direction) {
  alignas(64) int bad[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    const double length2 =
        direction.x[l] * direction.x[l] + direction.y[l] * direction.y[l] + direction.z[l] * direction.z[l];
    bad[l] = is_ray(length2, origin.x[l], origin.y[l], origin.z[l]) ? 0 : 1;
    const double scale = 1.0 / std::sqrt(length2);
    direction.x[l] *= scale;
    direction.y[l] *= scale;
    direction.z[l] *= scale;
  }
  int any = 0;
  for (int l = 0; l < kLanes; ++l) any |= bad[l];
  return any == 0;
}

/// Casts rays with individual origins in packets of 16.
class Caster {
 public:
  Caster(const Scene& scene, const PoseTrack& track) : scene_(scene) {
    for (std::size_t s = 0; s < scene.shapes().size(); ++s) {
      poses_.push_back(track.shape_from_reference(s, 0));
      LaneTransform& transform = transforms_.emplace_back();
      for (int l = 0; l < kLanes; ++l) set_lane(transform, l, poses_.back(), Eigen::Vector3d::Zero());
    }
  }

  /// Returns a function that gives the LaneTransform of a shape for rays from `origin`.
  auto transforms_from(const Lanes3& origin) {
    return [this, &origin](std::size_t shape) -> const LaneTransform& {
      transform(poses_[shape], origin, transforms_[shape].origin);
      return transforms_[shape];
    };
  }

  /// Finds the closest hits. False when a ray is not finite or has zero direction.
  bool cast(const double* origins, const double* directions, std::size_t first, int lanes,
            CastResult& result) {
    Lanes3 origin;
    Lanes3 direction;
    load(origins + 3 * first, lanes, origin);
    load(directions + 3 * first, lanes, direction);
    if (!normalize(origin, direction)) return false;
    alignas(64) int valid[kLanes];
    activate_lanes(static_cast<std::size_t>(lanes), valid);
    PacketHits hits;
    intersect_shapes(scene_.shapes(), transforms_from(origin), direction, valid, hits);
    for (int l = 0; l < lanes; ++l) {
      const std::size_t ray = first + static_cast<std::size_t>(l);
      const bool hit = hits.shape[l] >= 0;
      result.distance[ray] = hits.t[l];
      result.body[ray] = hit ? scene_.shapes()[static_cast<std::size_t>(hits.shape[l])].body : -1;
      result.face[ray] = hit ? static_cast<std::int64_t>(hits.face[l]) : -1;
    }
    return true;
  }

  /// Tests whether segments are occluded. False when a segment is not finite or has zero length.
  bool occlude(const double* starts, const double* ends, std::size_t first, int lanes,
               std::uint8_t* blocked) {
    Lanes3 origin;
    Lanes3 direction;
    load(starts + 3 * first, lanes, origin);
    load(ends + 3 * first, lanes, direction);
    if (!to_directions(origin, direction)) return false;
    alignas(64) int unoccluded[kLanes];
    activate_lanes(static_cast<std::size_t>(lanes), unoccluded);
    occlude_by_shapes(scene_.shapes(), transforms_from(origin), direction, 1.0, unoccluded);
    for (int l = 0; l < lanes; ++l) blocked[first + static_cast<std::size_t>(l)] = unoccluded[l] == 0 ? 1 : 0;
    return true;
  }

 private:
  const Scene& scene_;
  std::vector<Rigid3> poses_;
  std::vector<LaneTransform> transforms_;  ///< per shape; with the origins of the last packet
};

/// Calls body(caster, first ray, rays) for packets of up to 16 of `count` rays; stops when it returns false.
template <typename Body>
bool for_packets(const Scene& scene, const std::vector<Rigid3>& world_from_body, std::size_t count,
                 unsigned threads, const Body& body) {
  if (world_from_body.size() != scene.bodies().size()) {
    throw std::invalid_argument("world_from_body holds " + std::to_string(world_from_body.size()) +
                                " poses for " + std::to_string(scene.bodies().size()) + " bodies");
  }
  PoseTrack track;
  track.set_still(scene, world_from_body.data());
  std::atomic<bool> good{true};
  constexpr std::size_t kBlock = 64 * kLanes;
  parallel_for((count + kBlock - 1) / kBlock, threads, [&](std::size_t block, unsigned) {
    Caster caster(scene, track);
    const std::size_t end = std::min(count, (block + 1) * kBlock);
    for (std::size_t first = block * kBlock; first < end && good; first += kLanes) {
      if (!body(caster, first, static_cast<int>(std::min<std::size_t>(kLanes, end - first)))) good = false;
    }
  });
  return good;
}

}  // namespace

CastResult cast_rays(const Scene& scene, const std::vector<Rigid3>& world_from_body, const double* origins,
                     const double* directions, std::size_t count, unsigned threads) {
  CastResult result;
  result.distance.resize(count);
  result.body.resize(count);
  result.face.resize(count);
  const auto cast = [&](Caster& caster, std::size_t first, int lanes) {
    return caster.cast(origins, directions, first, lanes, result);
  };
  if (!for_packets(scene, world_from_body, count, threads, cast)) reject(origins, directions, false);
  return result;
}

LargeVector<std::uint8_t> occluded(const Scene& scene, const std::vector<Rigid3>& world_from_body,
                                   const double* starts, const double* ends, std::size_t count,
                                   unsigned threads) {
  LargeVector<std::uint8_t> blocked(count);
  const auto occlude = [&](Caster& caster, std::size_t first, int lanes) {
    return caster.occlude(starts, ends, first, lanes, blocked.data());
  };
  if (!for_packets(scene, world_from_body, count, threads, occlude)) reject(starts, ends, true);
  return blocked;
}

}  // namespace sensor_rt
