// Images with the laser off, taken away from images with the laser on. Internal to imaging.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/image.h"
#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {

/// The difference of two images of a camera, lifted by a pedestal so that noise below zero stays.
class LitDifference {
 public:
  /// `saturation`: level from which on a pixel of either image is not trusted.
  LitDifference(const ImageNoise& noise, float saturation);

  /// Throws std::invalid_argument when the images differ in size.
  ImageRows subtract(ImageRows lit, ImageRows unlit);

  /// What a difference looks like without a stripe, but for the light of the unlit image: offsets of pixels
  /// are gone, read noise and quantisation have come twice.
  const PixelNoise& noise() const { return noise_; }

 private:
  std::uint16_t trusted_;
  int pedestal_;
  int marker_;  ///< value of a pixel that is saturated in either image
  PixelNoise noise_;
  std::vector<std::uint16_t> difference_;
};

/// Sets the variance that the light of the unlit image brings to a candidate, once by each image, and takes
/// out the candidates that are no more than its noise. `unlit` minus `black` is that light, DN.
void allow_for_light(ImageRows unlit, float black, const PixelNoise& noise, double threshold_sigma,
                     std::vector<Candidate>& candidates);

}  // namespace sensor_rt
