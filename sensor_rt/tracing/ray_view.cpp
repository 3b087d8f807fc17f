#include "sensor_rt/tracing/ray_view.h"

#include <algorithm>
#include <numeric>

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
    }
  }
  order_.resize(shapes_.size());
  std::iota(order_.begin(), order_.end(), std::size_t{0});
  if (packets_ == 0) return;
  // Near shapes first: their hits exclude the others.
  std::vector<double> distance;  // of the first origin from the bounding box
  for (std::size_t k = 0; k < shapes_.size(); ++k) {
    const Eigen::Vector3d origin = lane(transforms_[k * packets_].origin, 0);
    const Eigen::Vector3d& half_size = scene.shapes()[shapes_[k]].half_size;
    distance.push_back((origin.cwiseAbs() - half_size).cwiseMax(0.0).norm());
  }
  std::stable_sort(order_.begin(), order_.end(),
                   [&](std::size_t a, std::size_t b) { return distance[a] < distance[b]; });
}

void RayView::intersect(std::size_t packet, const Lanes3& direction, const int* valid, PacketHits& hits,
                        double farthest) const {
  clear_hits(hits, farthest);
  for (const std::size_t k : order_) {
    const std::size_t at = k * packets_ + packet;
    const auto number = static_cast<std::int32_t>(shapes_[k]);
    intersect_shape(scene_->shapes()[shapes_[k]], number, transforms_[at], direction, valid, hits);
  }
}

void RayView::occlude(std::size_t packet, const Lanes3& segment, int* unoccluded) const {
  for (const std::size_t k : order_) {
    if (!any_lane(unoccluded)) return;
    const std::size_t at = k * packets_ + packet;
    occlude_by_shape(scene_->shapes()[shapes_[k]], transforms_[at], segment, kSegmentEnd, unoccluded);
  }
}

}  // namespace sensor_rt
