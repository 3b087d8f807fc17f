// Pixels that laser light can reach.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/render/pixels/fan_grid.h"
#include "sensor_rt/render/pixels/pixel_mask.h"

namespace sensor_rt {

/// Marks every pixel that may receive laser light at some instant of an exposure.
///
/// A grid of laser rays samples the sheet: across the fan, through its thickness, along its source and over
/// the exposure. Only closest hits count, so that steps, occlusions and several stripes per column need no
/// special cases. Two neighbouring rays bound a piece of surface when their hits lie within a few pixels of
/// each other in every camera and on each other's tangent plane; the pixels between them are marked.
/// Elsewhere the gap is bisected by further rays until that holds, or until an edge is located to a fraction
/// of a pixel, or to less than a thousandth of the ray spacing on steep surfaces. A feature thinner than the
/// ray spacing may be missed.
class LitPixelMarker {
 public:
  /// Two neighbouring rays and their hits.
  struct Gap {
    FanRay from;
    FanRay to;
    std::size_t from_index = 0;  ///< into Buffers::hits
    std::size_t to_index = 0;
    int depth = 0;
    bool across_sheet = false;  ///< the gap is across the thickness of the sheet
    bool in_grid = false;       ///< between neighbours of the grid along the sheet, source or exposure
  };
  /// Scratch memory.
  struct Buffers {
    std::vector<FanRay> rays;  ///< [instant][source][slope][angle], followed by refinement rays
    FanHits hits;
    std::vector<Gap> gaps;
    std::vector<Gap> next_gaps;
    std::vector<FanRay> middle;
    FanHits middle_hits;
  };

  /// The scene at the instants of an exposure. All must outlive it.
  LitPixelMarker(const RenderPlan& plan, const SceneQuery& query, Buffers& buffers);

  /// Marks the pixels in `masks`: one per camera, cleared by the caller.
  void mark(std::vector<PixelMask>& masks);

 private:
  enum class Relation {
    kDark,         ///< no light between the two, or not visible to any camera
    kSameSurface,  ///< close together on one surface
    kSteep,        ///< far apart on one surface
    kEdge,         ///< close together on two surfaces
    kVoid          ///< far apart on two surfaces, or one ray without a hit
  };

  void make_grid();
  void visit_grid(std::vector<PixelMask>& masks);
  void visit(const Gap& gap, std::vector<PixelMask>& masks);
  void refine(std::vector<PixelMask>& masks);
  Relation relate(const Gap& gap) const;
  /// Returns true when the hits lie within the margin of each other in every camera, so that the pixels
  /// marked around the ends cover the gap.
  bool adjacent_in_images(const Gap& gap) const;
  bool share_surface(const Gap& gap) const;
  static bool should_subdivide(const Gap& gap, Relation relation);
  void mark_between(std::size_t a, std::size_t b, std::vector<PixelMask>& masks) const;
  void mark_alone(std::size_t a, std::vector<PixelMask>& masks) const;
  /// Returns the margin, px, around two hits in a camera that may receive their light.
  float margin(std::size_t camera, std::size_t p, std::size_t q) const;
  std::vector<std::size_t> choose_instants() const;

  const RenderPlan& plan_;
  const PoseTrack& track_;
  const FanGrid grid_;
  std::size_t cameras_;
  std::size_t angles_;
  std::size_t slopes_;
  std::size_t instants_ = 0;  ///< of the grid
  Buffers& buffers_;
};

}  // namespace sensor_rt
