// Subtraction of background frames (laser off). Internal to imaging.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/image.h"
#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {

/// Difference of two images of a camera plus a pedestal that preserves negative noise, in counts: digital
/// numbers, or pairs of them at 16 bits, where the sum would not fit.
class BackgroundSubtraction {
 public:
  /// `saturation`: level from which pixels of either image are ignored.
  BackgroundSubtraction(const ImageNoise& noise, float saturation);

  /// Throws std::invalid_argument when the images differ in size.
  ImageRows subtract(ImageRows lit, ImageRows background);

  float dn_per_count() const { return static_cast<float>(1 << shift_); }

  /// Returns the noise, in counts, of the difference without stripe and background light: pixel offsets and
  /// the sensitivities to background light cancel, read noise and quantisation count twice.
  const PixelNoise& noise() const { return noise_; }

 private:
  std::uint16_t trusted_;
  int pedestal_;
  int shift_;   ///< bits that are dropped
  int marker_;  ///< value of a pixel that is saturated in either image
  PixelNoise noise_;
  std::vector<std::uint16_t> difference_;
};

/// Sets the variance due to the background light of each candidate, counted once per image, and removes the
/// candidates that do not exceed its noise. The light is `background` minus `black`, DN; all else in counts.
void add_background_noise(ImageRows background, float black, float dn_per_count, const PixelNoise& noise,
                          double threshold_sigma, std::vector<Candidate>& candidates);

}  // namespace sensor_rt
