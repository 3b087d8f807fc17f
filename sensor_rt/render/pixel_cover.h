// Which piece of surface fills a pixel.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/render/pixel_mask.h"
#include "sensor_rt/render/pixel_rays.h"
#include "sensor_rt/tracing/ray_view.h"
#include "sensor_rt/tracing/sight_lines.h"

namespace sensor_rt {

/// Looks along the corners of pixels, at the first and the last instant of an exposure, and from the laser at
/// what it meets there. Where all four corners of a pixel meet one face, or faces around one vertex, the
/// samples of the pixel need not search for what they meet; where the laser reaches all four, they need not
/// look for shadows. Neighbours share their corners, so that a pixel takes little more than one ray of each
/// kind instead of one per sample. On a mesh finer than the pixels the corners meet too many faces for that,
/// or there are more between them; where the surface runs on around the pixel, from each corner's face to the
/// next, and these lie on each other's planes, one plane stands for them.
///
/// What lies wholly between the corners of a pixel escapes, as does what crosses it and leaves again during
/// an exposure that moves far; there the cover is not used.
class PixelCover {
 public:
  explicit PixelCover(const RenderPlan& plan);

  /// Makes an exposure ready.
  void set(const Scene& scene, const PoseTrack& track);

  /// Begins the pixels of one camera. False when the cover cannot tell: its image is blurred, or the exposure
  /// moves too far.
  bool select_camera(std::size_t camera);

  /// What fills a marked pixel; patch.shape < 0 where that is not known. To be asked in the order of the
  /// mask.
  Patch patch(int column, int row, const PixelMask& mask);

 private:
  /// What lies behind the corner of a pixel at one instant.
  struct Corner {
    FaceId id;
    Eigen::Vector3d point = Eigen::Vector3d::Zero();  ///< in the reference frame
    bool from_front = false;  ///< the side of the face that is seen, after its winding
    bool in_light = false;
  };
  /// A corner lies above the pixel of its row and to the left of that of its edge.
  struct Place {
    int edge;
    int row;
  };

  /// The four corners of the pixel of this row in column_, around it.
  std::array<const Corner*, 4> around(int row, std::size_t instant) const;
  bool is_fine(const Shape& shape, std::uint32_t face) const;
  bool is_ring(const Shape& shape, int row) const;
  bool flatten(const Shape& shape, int row, Patch& patch) const;
  void set_light_lines(const Eigen::Vector3d& eye);
  void look_along(int first_edge, const PixelMask& mask);
  void look_along_packet(const Place* places, int count);
  std::size_t instants() const { return lane_instants_.size() / kLanes; }
  /// Where the corners of an edge begin, at [row * instants + instant] from there.
  Corner* corners_of(int edge) {
    return &corners_[static_cast<std::size_t>(edge % kEdgesKept) * corners_per_edge_];
  }
  const Corner* corners_of(int edge) const { return const_cast<PixelCover*>(this)->corners_of(edge); }

  const RenderPlan& plan_;
  PixelRays rays_;
  const Scene* scene_ = nullptr;
  const PoseTrack* track_ = nullptr;
  std::vector<std::size_t> lane_instants_;  ///< packet 0: the first of the exposure, packet 1: the last
  RayView view_;
  RayView laser_;
  Windows sheet_;                        ///< all that the laser lights, as it sees it
  std::vector<SightLines> light_lines_;  ///< from there to what a camera sees, per instant
  /// Packets are four corners wide, so that their rays stay close together.
  static constexpr int kEdgesAtOnce = 4;
  static constexpr int kEdgesKept = 2 * kEdgesAtOnce;
  int column_ = 0;     ///< of the last pixel asked for
  int next_edge_ = 0;  ///< corners from column_ up to here, without it, are known
  std::size_t corners_per_edge_ = 0;
  std::vector<Corner> corners_;
};

/// How far anything among `shapes` moves in any camera's image between first and last instant, in pixels.
double largest_motion_px(const SensorModel& model, const PoseTrack& track,
                         const std::vector<std::size_t>& shapes);

}  // namespace sensor_rt
