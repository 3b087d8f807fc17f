// How far speckle lets the light of neighbouring pixels fluctuate. Internal to imaging.
#pragma once

#include "sensor_rt/optics/camera.h"

namespace sensor_rt {

constexpr int kSpeckleRows = 12;

/// Covariance of the light of two pixels of a column, relative to their light, by how many rows they lie
/// apart; zeros without speckle.
struct SpeckleNoise {
  float covariance[kSpeckleRows] = {};

  bool enabled() const { return covariance[0] > 0.0f; }

  /// Variance of a pixel that counts its neighbours' covariance as its own: what sums over many grains see.
  float of_sums() const;
};

/// Speckle behind a circular aperture, averaged over square pixels; `contrast` is that of fully resolved
/// grains. Autocorrelation (2 J1(v) / v)², v = pi distance / (wavelength f-number) (Goodman, "Speckle
/// Phenomena in Optics", 2007).
SpeckleNoise speckle_noise(const Camera& camera, double wavelength, double contrast);

}  // namespace sensor_rt
