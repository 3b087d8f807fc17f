// Intensity fluctuations of neighbouring pixels due to speckle. Internal to imaging.
#pragma once

#include "sensor_rt/optics/camera.h"

namespace sensor_rt {

constexpr int kSpeckleRows = 12;

/// Relative covariance of the light of two pixels of a column as a function of their distance in rows; zeros
/// without speckle.
struct SpeckleNoise {
  float covariance[kSpeckleRows] = {};

  bool enabled() const { return covariance[0] > 0.0f; }

  /// Returns the effective variance of a pixel including the covariance with its neighbours, for sums over
  /// many grains.
  float of_sums() const;
};

/// Returns the speckle noise behind a circular aperture, averaged over square pixels; `contrast` is that of
/// fully resolved speckle. Autocorrelation (2 J1(v) / v)², v = pi distance / (wavelength f-number) (Goodman,
/// "Speckle Phenomena in Optics", 2007).
SpeckleNoise speckle_noise(const Camera& camera, double wavelength, double contrast);

}  // namespace sensor_rt
