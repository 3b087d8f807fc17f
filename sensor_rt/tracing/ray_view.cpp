#include "sensor_rt/tracing/ray_view.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/tracing/patch_trace.h"
#include "sensor_rt/tracing/trace.h"

namespace sensor_rt {
namespace {

/// Returns true when at every instant a half-space excludes the bounding box of the shape.
bool misses(const Shape& shape, std::size_t number, const PoseTrack& track,
            const std::vector<HalfSpace>& region) {
  for (std::size_t instant = 0; instant < track.instants(); ++instant) {
    const Rigid3& shape_from_reference = track.shape_from_reference(number, instant);
    const bool outside = std::any_of(region.begin(), region.end(), [&](const HalfSpace& half) {
      const Eigen::Vector3d normal =
          shape_from_reference.rotation * half.normal;  // in the frame of the shape
      const double reach = normal.cwiseAbs().dot(shape.half_size);
      const double centre = -normal.dot(shape_from_reference.translation);
      return centre + reach < half.offset;
    });
    if (!outside) return false;
  }
  return true;
}

/// Returns a lower bound of the distance of the origins from the bounding box of a shape.
SENSOR_RT_MULTIVERSION
double nearest_box(const Lanes3& __restrict origin, const double* __restrict half_size) {
  double distance2[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    const double x = std::abs(origin.x[l]) - half_size[0];
    const double y = std::abs(origin.y[l]) - half_size[1];
    const double z = std::abs(origin.z[l]) - half_size[2];
    distance2[l] = (x > 0.0 ? x * x : 0.0) + (y > 0.0 ? y * y : 0.0) + (z > 0.0 ? z * z : 0.0);
  }
  double least = distance2[0];
  for (int l = 1; l < kLanes; ++l) least = distance2[l] < least ? distance2[l] : least;
  constexpr double kSlack = 1e-6;
  return std::sqrt(least) * (1.0 - kSlack) - kSlack;
}

/// Returns true when a ray reaches `distance` before t.
SENSOR_RT_MULTIVERSION
bool any_reaches(double distance, const Lanes3& __restrict direction, const double* __restrict t) {
  alignas(64) int reaches[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    const double length2 =
        direction.x[l] * direction.x[l] + direction.y[l] * direction.y[l] + direction.z[l] * direction.z[l];
    reaches[l] = t[l] * t[l] * length2 < distance * distance ? 0 : 1;
  }
  int any = 0;
  for (int l = 0; l < kLanes; ++l) any |= reaches[l];
  return any != 0;
}

}  // namespace

void set_lane(LaneTransform& transform, int lane, const Rigid3& shape_from_reference,
              const Eigen::Vector3d& origin) {
  for (int k = 0; k < 9; ++k) transform.rotation[k][lane] = shape_from_reference.rotation(k / 3, k % 3);
  const Eigen::Vector3d local = shape_from_reference * origin;
  transform.origin.x[lane] = local.x();
  transform.origin.y[lane] = local.y();
  transform.origin.z[lane] = local.z();
}

void RayView::set(const SceneQuery& query, const std::vector<Eigen::Vector3d>& lane_origins,
                  const std::vector<std::size_t>& lane_instants, const std::vector<HalfSpace>& region) {
  const Scene& scene = query.scene();
  const PoseTrack& track = query.track();
  scene_ = &scene;
  packets_ = lane_instants.size() / kLanes;
  shapes_.clear();
  transforms_.clear();
  nearest_.clear();
  for (std::size_t s = 0; s < scene.shapes().size(); ++s) {
    if (!region.empty() && misses(scene.shapes()[s], s, track, region)) continue;
    shapes_.push_back(s);
    for (std::size_t packet = 0; packet < packets_; ++packet) {
      LaneTransform& transform = transforms_.emplace_back();
      for (int l = 0; l < kLanes; ++l) {
        const std::size_t lane = packet * kLanes + static_cast<std::size_t>(l);
        set_lane(transform, l, track.shape_from_reference(s, lane_instants[lane]),
                 lane_origins.size() == 1 ? lane_origins.front() : lane_origins[lane]);
      }
      nearest_.push_back(nearest_box(transform.origin, scene.shapes()[s].half_size.data()));
    }
  }
  order_.resize(shapes_.size());
  std::iota(order_.begin(), order_.end(), std::size_t{0});
  if (packets_ == 0) return;
  std::stable_sort(order_.begin(), order_.end(), [this](std::size_t a, std::size_t b) {
    return nearest_[a * packets_] < nearest_[b * packets_];
  });
}

void RayView::intersect(std::size_t packet, const Lanes3& direction, const int* valid, PacketHits& hits,
                        double farthest) const {
  clear_hits(hits, farthest);
  for (const std::size_t k : order_) {
    const std::size_t at = k * packets_ + packet;
    if (nearest_[at] > 0.0 && !any_reaches(nearest_[at], direction, hits.t)) continue;
    const auto number = static_cast<std::int32_t>(shapes_[k]);
    intersect_shape(scene_->shapes()[shapes_[k]], number, transforms_[at], direction, valid, hits);
  }
}

bool RayView::intersect_patch(std::size_t packet, const Patch& patch, const Lanes3& direction,
                              const int* valid, PacketHits& hits) const {
  if (patch.is_open) return false;
  const auto number = static_cast<std::size_t>(patch.shape);
  const auto in_view = std::lower_bound(shapes_.begin(), shapes_.end(), number) - shapes_.begin();
  const LaneTransform& transform = transforms_[static_cast<std::size_t>(in_view) * packets_ + packet];
  return sensor_rt::intersect_patch(scene_->shapes()[number], patch, transform, direction, valid, hits);
}

void RayView::occlude(std::size_t packet, const Lanes3& segment, int* unoccluded) const {
  alignas(64) double t[kLanes];
  std::fill(t, t + kLanes, kSegmentEnd);
  for (const std::size_t k : order_) {
    if (!any_lane(unoccluded)) return;
    const std::size_t at = k * packets_ + packet;
    if (nearest_[at] > 0.0 && !any_reaches(nearest_[at], segment, t)) continue;
    occlude_by_shape(scene_->shapes()[shapes_[k]], transforms_[at], segment, kSegmentEnd, unoccluded);
  }
}

}  // namespace sensor_rt
