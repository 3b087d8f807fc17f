// Error of a detector between pixels. Internal to imaging.
#pragma once

#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {

/// Root mean square error of a detector without noise, over all positions of a Gaussian stripe between two
/// pixels. It varies with the position and averages out over a slanted stripe, so that it belongs to the
/// standard deviation of a row; a fit of the pixel-integrated shape has none.
class InterpolationError {
 public:
  explicit InterpolationError(LocateFunction& locate);

  /// Returns the error (px) for a stripe of this standard deviation (px).
  float at(float width) const;

 private:
  static constexpr int kWidths = 32;
  float error_[kWidths];  ///< at widths of equal ratios
};

}  // namespace sensor_rt
