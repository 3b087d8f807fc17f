#include "sensor_rt/scene/ray_view.h"

#include <algorithm>

#include "sensor_rt/scene/trace.h"

namespace sensor_rt {
namespace {

/// True when at every instant some half-space holds no corner of the shape's bounding box.
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

void RayView::set(const Scene& scene, const PoseTrack& track,
                  const std::vector<Eigen::Vector3d>& lane_origins,
                  const std::vector<std::size_t>& lane_instants, const std::vector<HalfSpace>& region) {
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
}

void RayView::intersect(std::size_t packet, const Lanes3& direction, const int* valid, double farthest,
                        PacketHits& hits) const {
  clear_hits(hits, farthest);
  for (std::size_t k = 0; k < shapes_.size(); ++k) intersect_with(k, packet, direction, valid, hits);
}

void RayView::intersect_with(std::size_t k, std::size_t packet, const Lanes3& direction, const int* valid,
                             PacketHits& hits) const {
  intersect_shape(scene_->shapes()[shapes_[k]], static_cast<std::int32_t>(shapes_[k]),
                  transforms_[k * packets_ + packet], direction, valid, hits);
}

bool RayView::meet(std::size_t packet, const Patch& patch, const Lanes3& direction, const int* valid,
                   PacketHits& hits) const {
  const auto number = static_cast<std::size_t>(patch.shape);
  const auto in_view = std::lower_bound(shapes_.begin(), shapes_.end(), number) - shapes_.begin();
  const LaneTransform& transform = transforms_[static_cast<std::size_t>(in_view) * packets_ + packet];
  return meet_patch(scene_->shapes()[number], patch, transform, direction, valid, hits);
}

void RayView::occlude(std::size_t packet, const Lanes3& direction, double farthest, int* open) const {
  for (std::size_t k = 0; k < shapes_.size(); ++k) {
    if (std::none_of(open, open + kLanes, [](int lane) { return lane != 0; })) return;
    occlude_by(k, packet, direction, farthest, open);
  }
}

void RayView::occlude_by(std::size_t k, std::size_t packet, const Lanes3& direction, double farthest,
                         int* open) const {
  occlude_by_shape(scene_->shapes()[shapes_[k]], transforms_[k * packets_ + packet], direction, farthest,
                   open);
}

}  // namespace sensor_rt
