#include "sensor_rt/tracing/occlusion_culler.h"

#include <algorithm>

namespace sensor_rt {
namespace {

bool in_box(const Shape& shape, const Eigen::Vector3d& point) {
  constexpr double kSlack = 1e-6;  // m
  return (point.cwiseAbs() - shape.half_size).maxCoeff() <= kSlack;
}

/// Returns the bounding box as the first of eight boxes.
Aabb8 bounding_box(const Shape& shape) {
  Aabb8 boxes{};
  for (int k = 0; k < 3; ++k) {
    boxes.low[k][0] = static_cast<float>(-shape.half_size[k]);
    boxes.high[k][0] = static_cast<float>(shape.half_size[k]);
  }
  return boxes;
}

void find_occluders(const Shape& shape, const Rigid3& shape_from_reference, const OcclusionSetup& setting,
                    const ProjectedBoundsSet& bundles, ProjectedBoundsSet& occluders) {
  const ShaftCuller culler(shape_from_reference, setting.viewpoint, setting.axes, bundles);
  occluders.clear();
  ProjectedBounds seen[Aabb8::kCount];
  if (culler.cull(bounding_box(shape), 1u, seen) == 0) return;
  // A viewpoint and source outside the bounding box are outside the surface, and so are the points lit by the
  // source.
  const bool outside = !in_box(shape, shape_from_reference * setting.viewpoint) &&
                       !in_box(shape, shape_from_reference * setting.source);
  if (outside && !shape.back_faces.empty()) {
    shape.back_faces.find_back_faces(culler, occluders);
  } else {
    occluders.add(seen[0]);
  }
}

}  // namespace

void OcclusionCuller::set(const Scene& scene, const PoseTrack& track, const std::vector<std::size_t>& shapes,
                          const OcclusionSetup& setting, const ProjectedBoundsSet& bundles) {
  axes_ = setting.axes;
  occluders_.resize(shapes.size());
  for (std::size_t k = 0; k < shapes.size(); ++k) {
    find_occluders(scene.shapes()[shapes[k]], track.shape_from_reference(shapes[k], setting.instant), setting,
                   bundles, occluders_[k]);
  }
}

void OcclusionCuller::occlude(const RayView& view, std::size_t packet, const Lanes3& to_point,
                              const ProjectedBounds& bounds, double farthest, int* unoccluded) const {
  for (std::size_t k = 0; k < occluders_.size(); ++k) {
    if (!occluders_[k].overlaps(bounds)) continue;
    // Rays that graze a fine mesh are the most expensive: only those near a possible occluder are traced.
    alignas(64) int tested[kLanes];
    std::copy(unoccluded, unoccluded + kLanes, tested);
    occluders_[k].narrow(to_point, axes_, tested);
    if (std::none_of(tested, tested + kLanes, [](int lane) { return lane != 0; })) continue;
    alignas(64) int free[kLanes];
    std::copy(tested, tested + kLanes, free);
    view.occlude_by(k, packet, to_point, farthest, free);
    for (int l = 0; l < kLanes; ++l) unoccluded[l] = free[l] == tested[l] ? unoccluded[l] : 0;
  }
}

}  // namespace sensor_rt
