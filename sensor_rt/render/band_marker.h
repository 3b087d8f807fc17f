// Which pixels the laser can light.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/render/fan_grid.h"
#include "sensor_rt/render/pixel_mask.h"

namespace sensor_rt {

/// Marks every pixel that may see light of the laser at some instant of an exposure.
///
/// A grid of laser rays covers the sheet: across the fan, through its thickness and over the exposure. Each
/// ray lands where light lands, whatever lies behind it, so that steps, occlusions and several stripes per
/// column need no case of their own. Neighbours that land close together (a few pixels, in every camera)
/// bound a piece of surface, whose pixels are marked. Between neighbours that land far apart, or of which one
/// misses, more rays are cast, halving the gap until the landings are close or the gap is a true edge: less
/// than a thousandth of a ray's spacing then remains. What may escape is a feature thinner than the spacing
/// of the rays with gaps all around it.
class BandMarker {
 public:
  explicit BandMarker(const RenderPlan& plan);

  /// `masks`: one per camera, cleared. The track holds the instants of the exposure.
  void mark(const Scene& scene, const PoseTrack& track, std::vector<PixelMask>& masks);

 private:
  /// Two rays that are neighbours in one respect, and their landings.
  struct Gap {
    FanRay from;
    FanRay to;
    std::size_t from_index = 0;  ///< into landings_
    std::size_t to_index = 0;
    int depth = 0;
  };
  enum class Relation { kDark, kClose, kApart };

  void lay_grid(const Scene& scene, const PoseTrack& track);
  void visit_grid(std::vector<PixelMask>& masks);
  void visit(const Gap& gap, std::vector<PixelMask>& masks);
  void refine(std::vector<PixelMask>& masks);
  Relation relate(std::size_t a, std::size_t b) const;
  void mark_between(std::size_t a, std::size_t b, std::vector<PixelMask>& masks) const;
  void mark_alone(std::size_t a, std::vector<PixelMask>& masks) const;
  std::vector<std::size_t> choose_instants(const Scene& scene, const PoseTrack& track) const;

  const RenderPlan& plan_;
  FanGrid grid_;
  std::size_t cameras_;
  std::size_t angles_;
  std::size_t slopes_;
  std::size_t instants_ = 0;  ///< of the grid
  std::vector<FanRay> rays_;  ///< [instant][slope][angle], then what refinement adds
  FanLandings landings_;
  std::vector<Gap> gaps_;
  std::vector<Gap> next_gaps_;
  std::vector<FanRay> middle_;
  FanLandings middle_landings_;
};

}  // namespace sensor_rt
