// Speckle of laser light on rough surfaces.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstdint>
#include <vector>

#include "sensor_rt/render/emitter/speckle_tile.h"
#include "sensor_rt/render/exposure_views.h"

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
  /// The pattern of an exposure as one camera sees it.
  Speckle(const RenderPlan& plan, const ExposureViews& views, std::size_t camera);

  bool enabled() const { return plan_.speckle_tile != nullptr; }

  /// Multiplies `light` of the lanes with `lit` != 0, the `packet`-th sixteen samples of a pixel, with the
  /// hits `hits` along `direction`. `views`: of the row of the pixel.
  void modulate(const ExposureViews& views, int column, int row, std::size_t packet, const Lanes3& direction,
                const PacketHits& hits, const int* lit, double* light) const;

 private:
  /// Cell of a shape: image position of its centre and offset in the tile.
  struct Cell {
    std::int32_t shape = -1;
    std::array<std::int32_t, 3> index{};
    /// Offset added to pixel coordinates, steps of the tile.
    Eigen::Vector2d from_pixel = Eigen::Vector2d::Zero();
  };

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
