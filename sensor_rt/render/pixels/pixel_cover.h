// Surface patch that fills a pixel.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/render/integrator/pixel_rays.h"
#include "sensor_rt/render/pixels/pixel_mask.h"
#include "sensor_rt/tracing/ray_view.h"

namespace sensor_rt {

/// Traces rays through the corners of pixels, at the first and the last instant of an exposure, and shadow
/// rays from the laser to their hits. Where all four corners of a pixel hit one face, or faces around one
/// vertex, the samples of the pixel skip the traversal; where the laser reaches all four, they skip the
/// shadow rays. Neighbouring pixels share corners, so that a pixel needs little more than one ray of each
/// kind instead of one per sample. Corners of even column and row are traced first; between corners that hit
/// one lit face, which is convex, the others need no rays. On a mesh finer than the pixels the corners hit
/// too many faces; where the surface is continuous around the pixel and the faces are coplanar, a planar
/// proxy replaces them.
///
/// A feature entirely between the corners of a pixel is missed, in front of a single face one between corners
/// two pixels apart, and so is one that crosses the pixel during the exposure; the cover is not used for
/// large motion.
class PixelCover {
 public:
  /// Hit at the corner of a pixel at one instant.
  struct Corner {
    FaceId id;
    Eigen::Vector3d point = Eigen::Vector3d::Zero();  ///< in the reference frame
    bool from_front = false;                          ///< the front side (by winding) is visible
    bool in_light = false;
    int edge = -1;  ///< of the corner that is stored here
  };
  using Corners = std::vector<Corner>;

  /// Pixels of one camera. All must outlive it; `corners` is scratch memory.
  PixelCover(const RenderPlan& plan, const SceneQuery& query, std::size_t camera, const PixelMask& mask,
             Corners& corners);

  /// Returns false when the cover must not be used: the image is blurred, or the motion is too large.
  bool applies() const;

  /// Returns the patch that fills a marked pixel; patch.shape < 0 when several shapes or sides do. Must be
  /// called in the order of the mask.
  Patch patch(int column, int row);

 private:
  /// Index of a corner: above the pixel of its row and to the left of the pixel of its edge.
  struct CornerIndex {
    int edge;
    int row;
  };

  /// Returns the four corners of the pixel of this row in column_, in cyclic order.
  std::array<const Corner*, 4> around(int row, std::size_t instant) const;
  bool is_fine(const Shape& shape, std::uint32_t face) const;
  bool is_ring(const Shape& shape, int row) const;
  bool flatten(const Shape& shape, int row, Patch& patch) const;
  void trace_edges(int first_edge);
  void trace_corners(const CornerIndex* indices, int count);
  bool interpolate(int edge, int row);
  std::size_t instants() const { return lane_instants_.size() / kLanes; }
  /// Returns the corners of an edge; index [row * instants + instant].
  Corner* corners_of(int edge) {
    return &corners_[static_cast<std::size_t>(edge % kEdgesKept) * corners_per_edge_];
  }
  const Corner* corners_of(int edge) const { return const_cast<PixelCover*>(this)->corners_of(edge); }

  const RenderPlan& plan_;
  SceneQuery query_;
  const PixelMask& mask_;
  PixelRays rays_;
  std::vector<std::size_t> lane_instants_;  ///< packet 0: the first of the exposure, packet 1: the last
  RayView view_;
  RayView laser_;
  /// Packets are a few corners wide, for coherent rays.
  static constexpr int kEdgesAtOnce = 4;
  static constexpr int kEdgesKept = 2 * kEdgesAtOnce;
  int column_ = 0;                    ///< of the last requested pixel
  int next_edge_ = 1 - kEdgesAtOnce;  ///< corners of the columns column_ .. next_edge_ - 1 are known
  std::size_t corners_per_edge_ = 0;
  Corners& corners_;
};

/// Returns a bound of the motion of `shapes` in any camera image from the first instant to any other, over
/// the laser line within the measuring range, in pixels.
double max_motion_px(const SensorModel& model, const PoseTrack& track,
                     const std::vector<std::size_t>& shapes);

}  // namespace sensor_rt
