// Ambient light on pixels that the laser does not reach.
#pragma once

#include <vector>

#include "sensor_rt/render/pixel_mask.h"
#include "sensor_rt/render/pixel_tracer.h"

namespace sensor_rt {

/// Calls add(column, row, electrons per second) for every unmarked pixel that sees a surface.
///
/// Ambient light is uniform and has no occlusion here (path tracing has it), so that the image is constant
/// wherever one reflectance fills the view. One ray is traced at each corner of a grid of 8 x 8 pixels.
/// Blocks whose corners agree are filled; in all others every pixel gets a ray through its centre, at
/// mid-exposure. A detail within one block is missed.
class AmbientFiller {
 public:
  template <typename Add>
  void fill(PixelTracer& tracer, int width, int height, const PixelMask& mask, double irradiance,
            const Add& add) {
    lay_grid(tracer, width, height);
    for (int row = 0; row < height; ++row) {
      for (int column = 0; column < width; ++column) {
        if (mask.test(column, row)) continue;
        const double flat = block_reflectance(column / kBlock, row / kBlock);
        const double reflectance = flat >= 0.0 ? flat : tracer.reflectance(column, row);
        if (reflectance > 0.0) add(column, row, tracer.electrons(column, row, reflectance * irradiance));
      }
    }
  }

 private:
  static constexpr int kBlock = 8;

  void lay_grid(PixelTracer& tracer, int width, int height);
  /// Returns the reflectance of a block whose corners agree, else -1.
  double block_reflectance(int block_column, int block_row) const;

  int columns_ = 0;
  std::vector<double> corners_;
};

}  // namespace sensor_rt
