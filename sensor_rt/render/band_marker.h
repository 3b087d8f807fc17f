// Which pixels the laser can light.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/render/fan_grid.h"
#include "sensor_rt/render/pixel_mask.h"

namespace sensor_rt {

/// Marks every pixel that may see light of the laser at some instant of an exposure.
///
/// A grid of laser rays covers the sheet: across the fan, through its thickness, along its source and over
/// the exposure. Each ray lands where light lands, whatever lies behind it, so that steps, occlusions and
/// several stripes per column need no case of their own. Neighbours bound a piece of surface when they land
/// within a few pixels of each other in every camera and on each other's tangent plane; the pixels between
/// them are marked. Elsewhere more rays are cast, halving the gap until that holds, or an edge is closed in
/// to a fraction of a pixel, or to less than a thousandth of the spacing where the surface falls away
/// steeply. What may escape is a feature thinner than the spacing of the rays that leaves no trace in its
/// neighbours.
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
    bool along_sheet = false;  ///< not through its thickness, along which both ends have neighbours too
  };
  enum class Relation {
    kDark,        ///< no light between the two, or no camera looks
    kOneSurface,  ///< close to each other on one surface
    kSteep,       ///< far apart on one surface
    kEdge,        ///< close to each other on two surfaces
    kVoid         ///< far apart on two surfaces, or one ray lands nowhere
  };

  void lay_grid(const PoseTrack& track);
  void visit_grid(std::vector<PixelMask>& masks);
  void visit(const Gap& gap, std::vector<PixelMask>& masks);
  void refine(std::vector<PixelMask>& masks);
  Relation relate(const Gap& gap) const;
  /// Within the margin of each other in every camera: what the ends mark with their neighbours through the
  /// sheet covers what lies between them.
  bool side_by_side(const Gap& gap) const;
  bool on_one_surface(const Gap& gap) const;
  static bool worth_halving(const Gap& gap, Relation relation);
  void mark_between(std::size_t a, std::size_t b, std::vector<PixelMask>& masks) const;
  void mark_alone(std::size_t a, std::vector<PixelMask>& masks) const;
  /// Pixels around two landings in a camera that may see the light there.
  float margin(std::size_t camera, std::size_t p, std::size_t q) const;
  std::vector<std::size_t> choose_instants(const PoseTrack& track) const;

  const RenderPlan& plan_;
  FanGrid grid_;
  std::size_t cameras_;
  std::size_t angles_;
  std::size_t slopes_;
  std::vector<Eigen::Vector2d> across_fan_;  ///< sine and cosine of each angle
  std::size_t instants_ = 0;                 ///< of the grid
  std::vector<FanRay> rays_;                 ///< [instant][source][slope][angle], then what refinement adds
  FanLandings landings_;
  std::vector<Gap> gaps_;
  std::vector<Gap> next_gaps_;
  std::vector<FanRay> middle_;
  FanLandings middle_landings_;
};

}  // namespace sensor_rt
