// Lines of sight from a camera to what the laser has lit, and what may stand in them.
#pragma once

#include <vector>

#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/scene/sight.h"
#include "sensor_rt/tracing/ray_view.h"

namespace sensor_rt {

/// Where all lines of sight and the light come from, in the reference frame of a track. Light and sight may
/// change places.
struct SightSetting {
  Eigen::Vector3d source;  ///< of the light
  Eigen::Vector3d eye;
  ViewAxes axes = ViewAxes::kX;  ///< of the eye
  std::size_t instant = 0;       ///< of the track
};

/// Tells for bundles of lines of sight which shapes can hide their points. The points must be the first that
/// rays from the source meet, seen from the side that is lit.
class SightLines {
 public:
  /// `shapes`: numbers of those to look at. `bundles` hold all lines of sight.
  void set(const Scene& scene, const PoseTrack& track, const std::vector<std::size_t>& shapes,
           const SightSetting& setting, const Windows& bundles);

  /// Clears open[lane] where something stands before `farthest` of the way from the eye. `window` holds the
  /// ways of all open lanes and lies within the bundles, `view` the shapes that were given, from the eye, at
  /// the instant in `packet`.
  void occlude(const RayView& view, std::size_t packet, const Lanes3& way, const Window& window,
               double farthest, int* open) const;

 private:
  ViewAxes axes_ = ViewAxes::kX;
  std::vector<Windows> hiding_;  ///< of each shape what may hide something
};

}  // namespace sensor_rt
