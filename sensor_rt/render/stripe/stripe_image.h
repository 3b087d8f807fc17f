// Image of the stripe before noise.
#pragma once

#include "sensor_rt/render/sparse_image.h"
#include "sensor_rt/render/stripe/column_image.h"

namespace sensor_rt {

/// Image of the stripe, electrons per second.
struct StripeImage {
  ColumnImage even;    ///< without speckle
  ColumnImage grainy;  ///< with speckle; no columns where there is none

  bool has_speckle() const { return grainy.columns() > 0; }
  void resize(int columns, int rows, bool has_speckle) {
    even.resize(columns, rows);
    grainy.resize(has_speckle ? columns : 0, has_speckle ? rows : 0);
  }
  /// Records that rows `from` to `to` of a column hold light.
  void touch(int column, int from, int to) {
    even.touch(column, from, to);
    if (has_speckle()) grainy.touch(column, from, to);
  }
  /// Appends the first width × height pixels to `to`, times `scale`, and clears the image.
  void move_to(SparseImage& to, int width, int height, float scale) {
    (has_speckle() ? grainy : even).move_to(to, 0, 0, width, height, scale);
    for (int column = 0; column < even.columns() && has_speckle(); ++column) even.clear(column);
  }
};

}  // namespace sensor_rt
