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
/// does not change when the surface rotates; the patterns of different cameras are independent. Blur by the
/// lens does not change the grains, which the whole aperture forms on the image sensor.
class Speckle {
 public:
  /// Cell of a shape: image position of its centre and offset in the tile.
  struct Cell {
    std::int32_t shape = -1;
    std::array<std::int32_t, 3> index{};
    /// Offset added to pixel coordinates, steps of the tile.
    Eigen::Vector2d from_pixel = Eigen::Vector2d::Zero();
  };

  /// Position of the pattern where the image shows a small part of a surface, at one time or two.
  struct Patch {
    int times = 1;
    std::array<Eigen::Vector2d, 2> from_pixel;  ///< offset added to pixel coordinates, steps of the tile
  };

  /// The pattern of an exposure as one camera sees it. The track must outlive it.
  Speckle(const RenderPlan& plan, const Scene& scene, const PoseTrack& track, std::size_t camera);

  bool enabled() const { return plan_.speckle_tile != nullptr; }

  /// Returns the factor at a point of a shape (reference frame) that is seen at `pixel`. The point has the
  /// pose of an instant of the track. `cell`: memory from call to call.
  double at_point(std::size_t instant, std::int32_t shape, const Eigen::Vector3d& point,
                  const Eigen::Vector2d& pixel, Cell& cell) const;

  /// Returns the patch around a point of a shape that travels during the time interval around an instant.
  Patch patch(std::size_t instant, std::int32_t shape, const Eigen::Vector3d& point,
              const Eigen::Vector3d& travel, Cell& cell) const;

  /// Returns the mean factor over the size of a pixel around an image point that shows a patch: light is
  /// taken as uniform within a pixel.
  float over_pixel(const Eigen::Vector2d& point, const Patch& patch) const {
    const SpeckleTile& tile = *plan_.pixel_speckle[camera_];
    const Eigen::Vector2d step = steps_per_pixel_ * point;
    const float first = tile.at(step + patch.from_pixel[0]);
    return patch.times == 1 ? first : 0.5f * (first + tile.at(step + patch.from_pixel[1]));
  }

 private:
  void enter(std::int32_t shape, const Eigen::Vector3d& point_in_shape, Cell& cell) const;
  Eigen::Vector2d image(const Eigen::Vector3d& point) const;
  Eigen::Vector2d from_pixel(std::size_t instant, std::int32_t shape, const Eigen::Vector3d& point,
                             Cell& cell) const;

  const RenderPlan& plan_;
  const PoseTrack& track_;
  std::size_t camera_;
  Rigid3 camera_from_sensor_;
  double steps_per_pixel_ = 0.0;
  double cell_size_ = 0.0;                    ///< m
  std::vector<Rigid3> reference_from_shape_;  ///< at mid-exposure
};

}  // namespace sensor_rt
