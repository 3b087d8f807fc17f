// When the rows of an image are exposed with a rolling shutter.
#pragma once

#include <algorithm>

#include "sensor_rt/optics/sensor_model.h"

namespace sensor_rt {

/// Rows are exposed one after the other, each for `open` seconds. Time counts from the start of the first row
/// of the tallest camera; the middle row of each camera is exposed at the centre of the time of all rows.
struct RowTiming {
  RowTiming() = default;
  RowTiming(const SensorModel& model, double row_readout, double duration)
      : readout(row_readout), open(duration) {
    for (const Camera& camera : model.cameras) tallest = std::max(tallest, camera.height_px);
  }

  double readout = 0.0;  ///< s from row to row; 0: all rows are exposed simultaneously
  double open = 0.0;     ///< s
  int tallest = 0;       ///< rows of the tallest camera

  /// Returns the time until the end of the last row, s.
  double span() const { return open + readout * (tallest - 1); }
  /// Returns the start of a row in units of half the readout time, which all cameras share.
  int half_rows(const Camera& camera, int row) const { return 2 * row + tallest - camera.height_px; }
  /// Returns the start of a row, s.
  double start(int half_rows) const { return 0.5 * half_rows * readout; }
};

}  // namespace sensor_rt
