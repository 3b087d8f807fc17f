#include "sensor_rt/tracing/sight_lines.h"

#include <algorithm>

namespace sensor_rt {
namespace {

bool in_box(const Shape& shape, const Eigen::Vector3d& point) {
  constexpr double kSlack = 1e-6;  // m
  return (point.cwiseAbs() - shape.half_size).maxCoeff() <= kSlack;
}

/// The bounding box, as the first of eight.
EightBoxes bounding_box(const Shape& shape) {
  EightBoxes boxes{};
  for (int k = 0; k < 3; ++k) {
    boxes.low[k][0] = static_cast<float>(-shape.half_size[k]);
    boxes.high[k][0] = static_cast<float>(shape.half_size[k]);
  }
  return boxes;
}

void find_hiding(const Shape& shape, const Rigid3& shape_from_reference, const SightSetting& setting,
                 const Windows& bundles, Windows& hiding) {
  const Sight sight(shape_from_reference, setting.eye, setting.axes, bundles);
  hiding.clear();
  Window seen[EightBoxes::kCount];
  if (sight.see(bounding_box(shape), 1u, seen) == 0) return;
  // Eye and source outside the bounding box are outside the surface, and so is what the source lights.
  const bool outside = !in_box(shape, shape_from_reference * setting.eye) &&
                       !in_box(shape, shape_from_reference * setting.source);
  if (outside && !shape.facing.empty()) {
    shape.facing.find_turned_away(sight, hiding);
  } else {
    hiding.add(seen[0]);
  }
}

}  // namespace

void SightLines::set(const Scene& scene, const PoseTrack& track, const std::vector<std::size_t>& shapes,
                     const SightSetting& setting, const Windows& bundles) {
  axes_ = setting.axes;
  hiding_.resize(shapes.size());
  for (std::size_t k = 0; k < shapes.size(); ++k) {
    find_hiding(scene.shapes()[shapes[k]], track.shape_from_reference(shapes[k], setting.instant), setting,
                bundles, hiding_[k]);
  }
}

void SightLines::occlude(const RayView& view, std::size_t packet, const Lanes3& way, const Window& window,
                         double farthest, int* open) const {
  for (std::size_t k = 0; k < hiding_.size(); ++k) {
    if (!hiding_[k].meet(window)) continue;
    // Ways that graze a fine mesh cost most: only those that something may cut are traced.
    alignas(64) int asked[kLanes];
    std::copy(open, open + kLanes, asked);
    hiding_[k].narrow(way, axes_, asked);
    if (std::none_of(asked, asked + kLanes, [](int lane) { return lane != 0; })) continue;
    alignas(64) int free[kLanes];
    std::copy(asked, asked + kLanes, free);
    view.occlude_by(k, packet, way, farthest, free);
    for (int l = 0; l < kLanes; ++l) open[l] = free[l] == asked[l] ? open[l] : 0;
  }
}

}  // namespace sensor_rt
