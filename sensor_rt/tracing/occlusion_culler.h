// Occlusion tests for lines of sight between a camera and points lit by the laser.
#pragma once

#include <vector>

#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/scene/shaft_culler.h"
#include "sensor_rt/tracing/ray_view.h"

namespace sensor_rt {

/// Origins of the lines of sight and of the light, in the reference frame of a track. The two may be
/// exchanged.
struct OcclusionSetup {
  Eigen::Vector3d source;  ///< of the light
  Eigen::Vector3d viewpoint;
  ViewAxes axes = ViewAxes::kX;  ///< of the viewpoint
  std::size_t instant = 0;       ///< of the track
};

/// Finds the shapes that can occlude bundles of lines of sight. The points must be closest hits of rays from
/// the source, seen from the lit side.
class OcclusionCuller {
 public:
  /// `shapes`: indices of the potential occluders. `bundles` contain all lines of sight.
  void set(const Scene& scene, const PoseTrack& track, const std::vector<std::size_t>& shapes,
           const OcclusionSetup& setting, const ProjectedBoundsSet& bundles);

  /// Clears unoccluded[lane] for lines of sight that are blocked before the fraction `farthest` of their
  /// length. `bounds` contain all active lanes and lie within the bundles; `view` holds the given shapes as
  /// seen from the viewpoint, at the instant in `packet`.
  void occlude(const RayView& view, std::size_t packet, const Lanes3& to_point, const ProjectedBounds& bounds,
               double farthest, int* unoccluded) const;

 private:
  ViewAxes axes_ = ViewAxes::kX;
  std::vector<ProjectedBoundsSet> occluders_;  ///< projected bounds of the possible occluders, per shape
};

}  // namespace sensor_rt
