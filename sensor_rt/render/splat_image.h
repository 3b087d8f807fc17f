// Light that arrives at points of the image, each spread over a patch of its own size.
#pragma once

#include <vector>

#include "sensor_rt/geometry/image.h"

namespace sensor_rt {

/// A pyramid of grids whose cells grow by factors of two: a point goes to the grid that suits its patch, and
/// in the end every grid is interpolated into the next finer one. No light is lost but what falls off the
/// borders.
class SplatImage {
 public:
  void resize(int width, int height);
  void clear();

  /// Adds `amount` at (column, row), spread over about `size` pixels; below 1.5 the pixel gets it all.
  void add(double column, double row, double amount, double size);

  /// Sum of everything, per pixel.
  ImageView<const float> resolve();

 private:
  static constexpr int kLevels = 6;  ///< cells of 1 to 32 pixels

  struct Grid {
    Image<float> cells;  ///< with a border of one cell
    bool used = false;
  };

  static void fold_border(const ImageView<float>& cells);
  static void pass_down(Grid& coarse, Grid& fine);

  Grid grids_[kLevels];
};

}  // namespace sensor_rt
