// Accumulation of splats of different sizes.
#pragma once

#include <vector>

#include "sensor_rt/geometry/image.h"

namespace sensor_rt {

/// Pyramid of grids whose cell size doubles per level: a splat is added to the grid of matching cell size,
/// and finally every grid is interpolated into the next finer one. Energy is conserved except at the borders.
class SplatImage {
 public:
  /// Makes the image empty.
  void reset(int width, int height);

  /// Adds `amount` at (column, row), a point of the image, spread over about `size` pixels; below 1.5 to a
  /// single pixel. The coordinates are at least -0.5 and at most the number of columns or rows less 0.5.
  void add(double column, double row, double amount, double size);

  /// Returns the sum of all splats per pixel.
  ImageView<const float> resolve();

 private:
  static constexpr int kLevels = 6;  ///< cell sizes of 1 to 32 pixels

  struct Grid {
    Image<float> cells;  ///< with a border of one cell
    bool used = false;
  };

  static void fold_border(const ImageView<float>& cells);
  static void pass_down(Grid& coarse, Grid& fine);

  Grid grids_[kLevels];
};

}  // namespace sensor_rt
