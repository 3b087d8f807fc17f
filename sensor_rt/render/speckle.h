// Speckle of laser light on rough surfaces.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/speckle_tile.h"

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
  explicit Speckle(const RenderPlan& plan);

  bool enabled() const { return tile_ != nullptr; }

  /// `views` must outlive its use.
  void set(const ExposureViews& views);
  void select_camera(std::size_t camera);
  /// Switches to other instants of the same exposure; the pattern is kept.
  void use(const ExposureViews& views) { views_ = &views; }

  /// Multiplies `light` of the lanes with `lit` != 0, the `packet`-th sixteen samples of a pixel, with the
  /// hits `hits` along `direction`.
  void modulate(int column, int row, std::size_t packet, const Lanes3& direction, const PacketHits& hits,
                const int* lit, double* light);

 private:
  /// Cell of a shape: image position of its centre and offset in the tile.
  struct Cell {
    std::int32_t shape = -1;
    std::array<std::int32_t, 3> place{};
    Eigen::Vector2d from_pixel =
        Eigen::Vector2d::Zero();  ///< offset added to pixel coordinates, steps of the tile
  };

  void enter(std::int32_t shape, const Eigen::Vector3d& point_in_shape);
  Eigen::Vector2d motion(std::int32_t shape, const Eigen::Vector3d& point,
                         const Eigen::Vector3d& point_in_shape) const;

  const RenderPlan& plan_;
  std::shared_ptr<const SpeckleTile> tile_;  ///< null: no speckle
  const ExposureViews* views_ = nullptr;
  std::vector<Rigid3> reference_from_shape_;  ///< at mid-exposure
  // The selected camera:
  std::size_t camera_ = 0;
  Rigid3 camera_from_sensor_;
  double steps_per_pixel_ = 0.0;
  double cell_size_ = 0.0;  ///< m
  Cell cell_;               ///< current cell
};

}  // namespace sensor_rt
