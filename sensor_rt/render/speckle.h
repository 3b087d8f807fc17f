// Speckle: the grain of laser light on rough surfaces, as a camera sees it.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "sensor_rt/render/exposure_views.h"
#include "sensor_rt/render/grain_tile.h"

namespace sensor_rt {

/// Subjective speckle on directly seen laser light, as a factor of mean 1. Its grain is wavelength * working
/// f-number on the image, and fully resolved grains have the given contrast.
///
/// The pattern belongs to the surface: it is anchored to cells of each shape, about a hundred grains wide,
/// each with a piece of the tile of its own, and moves with the cell's image. A still scene shows the same
/// grains in every exposure, and surface that moves through the sheet during an exposure averages them.
/// Within a cell, grains keep their places on the image while the surface turns; patterns of different
/// cameras are unrelated.
class Speckle {
 public:
  explicit Speckle(const RenderPlan& plan);

  bool enabled() const { return tile_ != nullptr; }

  /// `views` must stay.
  void set(const ExposureViews& views);
  void select_camera(std::size_t camera);
  /// Other instants of the same exposure, on which its grains stay as they are.
  void use(const ExposureViews& views) { views_ = &views; }

  /// Multiplies `light` of the lanes with `lit` != 0, the `packet`-th sixteen samples of a pixel, which have
  /// met `hits` along `direction`.
  void modulate(int column, int row, std::size_t packet, const Lanes3& direction, const PacketHits& hits,
                const int* lit, double* light);

 private:
  /// A piece of a shape: where its middle is seen, and which part of the tile covers it.
  struct Cell {
    std::int32_t shape = -1;
    std::array<std::int32_t, 3> place{};
    Eigen::Vector2d from_pixel = Eigen::Vector2d::Zero();  ///< steps of the tile, to be added
  };

  void enter(std::int32_t shape, const Eigen::Vector3d& point_in_shape);
  Eigen::Vector2d motion(std::int32_t shape, const Eigen::Vector3d& point,
                         const Eigen::Vector3d& point_in_shape) const;

  const RenderPlan& plan_;
  std::shared_ptr<const GrainTile> tile_;  ///< null: no speckle
  const ExposureViews* views_ = nullptr;
  std::vector<Rigid3> reference_from_shape_;  ///< at mid-exposure
  // The selected camera:
  std::size_t camera_ = 0;
  Rigid3 camera_from_sensor_;
  double steps_per_pixel_ = 0.0;
  double cell_size_ = 0.0;  ///< m
  Cell cell_;               ///< entered last
};

}  // namespace sensor_rt
