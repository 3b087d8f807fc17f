// Lines of sight from a camera to what the laser has lit, and what may stand in them.
#pragma once

#include <vector>

#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/scene/sight.h"

namespace sensor_rt {

/// Where all lines of sight and the light come from, in the reference frame of a track.
struct SightSetting {
  Eigen::Vector3d source;  ///< of the light
  Eigen::Vector3d eye;
  int side = 1;  ///< the eye looks along -X for +1, along +X for -1
};

/// Tells for bundles of lines of sight which shapes can hide their points, at the first instant of a track.
/// The points must be the first that rays from the source meet, seen from the side that is lit.
class SightLines {
 public:
  /// `shapes`: numbers of those to look at. `bundles` hold all lines of sight.
  void set(const Scene& scene, const PoseTrack& track, const std::vector<std::size_t>& shapes,
           const SightSetting& setting, const Windows& bundles);

  /// False when the k-th of `shapes` hides nothing within the window.
  bool may_hide(std::size_t k, const Window& window) const { return hiding_[k].meet(window); }

 private:
  std::vector<Windows> hiding_;  ///< of each shape what may hide something
};

}  // namespace sensor_rt
