// Light behind the stripe, such as room light. Internal to imaging.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {

/// Smooth background of an image, from a sample of its pixels. It serves the search for stripes; the
/// background under a stripe is measured on either side of it.
class BackgroundLight {
 public:
  /// Measures an image. `noise`: that of pixels without light; `black`: their level.
  void measure(ImageRows image, float black, const PixelNoise& noise);

  /// Whether the background is the same in the entire image, within its noise.
  bool is_uniform() const { return uniform_; }

  /// Returns the typical level, DN; exactly `black` unless the sample shows light.
  float level() const { return level_; }

  /// Returns the variance of pixels at this level if it is uniform, DN²; at most that of `noise` with the
  /// light. Digital numbers of a quiet pixel do not vary at all.
  float variance() const { return variance_; }

  /// Returns the image less its background plus `pedestal`, from 0 to `largest`.
  ImageRows subtract(ImageRows image, int pedestal, int largest);

  /// Sets the background under a candidate to that of the smooth background at its rows.
  void place(Candidate& candidate) const;

 private:
  void fit_cells(float sigma);
  bool is_better(float level, float tolerance) const;
  float at(int column, int row) const;

  bool uniform_ = true;
  float level_ = 0.0f;
  float variance_ = 0.0f;
  int width_ = 0;
  int height_ = 0;
  int cell_rows_ = 1;
  std::vector<float> cells_;  ///< level at the centre of each cell, row by row
  std::vector<float> sample_;
  std::vector<float> sorted_;
  std::vector<float> lines_;
  std::vector<std::uint16_t> difference_;
};

/// Sets the background under a candidate, whose centre and width are known, to the line through the levels on
/// both sides of the stripe if both are free of other light. Its rows become those around the centre whose
/// sum with both neighbours exceeds the background by `threshold`.
void measure_background(ImageRows image, const PixelNoise& noise, float threshold, Candidate& candidate);

}  // namespace sensor_rt
