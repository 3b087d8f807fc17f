// Ambient light on pixels that the laser does not reach.
#pragma once

#include <vector>

#include "sensor_rt/render/integrator/pixel_tracer.h"
#include "sensor_rt/render/pixels/pixel_mask.h"

namespace sensor_rt {

/// Reflectances at the corners of blocks of 8 x 8 pixels, by one ray each.
class AmbientGrid {
 public:
  static constexpr int kBlock = 8;

  AmbientGrid(const PixelTracer& tracer, int width, int height);

  /// Returns the reflectance of a block whose corners agree, else -1.
  double block_reflectance(int block_column, int block_row) const;

 private:
  int columns_;
  std::vector<double> corners_;
};

/// Calls add(column, row, electrons per second) for every unmarked pixel that sees a surface.
///
/// Ambient light is uniform and has no occlusion here (path tracing has it), so that the image is constant
/// wherever one reflectance fills the view. Blocks whose corners agree are filled; in all others every pixel
/// gets a ray through its centre, at mid-exposure. A detail within one block is missed.
template <typename Add>
void fill_ambient(const PixelTracer& tracer, int width, int height, const PixelMask& mask, double irradiance,
                  const Add& add) {
  const AmbientGrid grid(tracer, width, height);
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      if (mask.test(column, row)) continue;
      const double flat = grid.block_reflectance(column / AmbientGrid::kBlock, row / AmbientGrid::kBlock);
      const double reflectance = flat >= 0.0 ? flat : tracer.reflectance(column, row);
      if (reflectance > 0.0) add(column, row, tracer.electrons(column, row, reflectance * irradiance));
    }
  }
}

}  // namespace sensor_rt
