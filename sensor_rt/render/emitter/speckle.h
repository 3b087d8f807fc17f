// Speckle of laser light on rough surfaces.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstdint>
#include <vector>

#include "sensor_rt/render/emitter/speckle_tile.h"
#include "sensor_rt/render/render_plan.h"
#include "sensor_rt/scene/pose_track.h"

namespace sensor_rt {

/// Subjective speckle on directly visible laser light, as a factor of mean 1. The grain size is wavelength *
/// working f-number on the image; fully resolved speckle has the given contrast.
///
/// The pattern is fixed to the surface: each shape is divided into cells about a hundred grains wide, each
/// with its own region of the tile, which moves with the image of the cell. Without motion all exposures have
/// the same pattern, and motion through the sheet during an exposure averages it. Within a cell the pattern
/// does not change when the surface rotates; the patterns of different cameras are independent.
class Speckle {
 public:
  /// Cell of a shape: image position of its centre and offset in the tile.
  struct Cell {
    std::int32_t shape = -1;
    std::array<std::int32_t, 3> index{};
    /// Offset added to pixel coordinates, steps of the tile.
    Eigen::Vector2d from_pixel = Eigen::Vector2d::Zero();
  };

  /// The pattern of an exposure as one camera sees it. The track must outlive it.
  Speckle(const RenderPlan& plan, const Scene& scene, const PoseTrack& track, std::size_t camera);

  bool enabled() const { return plan_.speckle_tile != nullptr; }

  /// Returns the factor at a point of a shape (reference frame) that is seen at `pixel`. `track`: poses of
  /// the exposure, of which the point has those of an instant. `cell`: memory from call to call.
  double factor(const PoseTrack& track, std::size_t instant, std::int32_t shape, const Eigen::Vector3d& point,
                const Eigen::Vector2d& pixel, Cell& cell) const;

 private:
  void enter(std::int32_t shape, const Eigen::Vector3d& point_in_shape, Cell& cell) const;
  Eigen::Vector2d motion(std::int32_t shape, const Eigen::Vector3d& point,
                         const Eigen::Vector3d& point_in_shape) const;

  const RenderPlan& plan_;
  std::size_t camera_;
  Rigid3 camera_from_sensor_;
  double steps_per_pixel_ = 0.0;
  double cell_size_ = 0.0;                    ///< m
  std::vector<Rigid3> reference_from_shape_;  ///< at mid-exposure
};

}  // namespace sensor_rt
