#include "sensor_rt/imaging/speckle_noise.h"

#include <cmath>

namespace sensor_rt {
namespace {

/// Returns the autocovariance of fully developed speckle at a distance in grains.
double autocorrelation(double grains) {
  const double v = M_PI * grains;
  if (v < 1e-6) return 1.0;
  const double amplitude = 2.0 * ::j1(v) / v;
  return amplitude * amplitude;
}

/// Returns the covariance averaged over two pixels `rows` apart: distances within pixels have a triangular
/// distribution.
double pixel_covariance(double grain_px, int rows) {
  constexpr int kSteps = 24;
  double sum = 0.0;
  double weights = 0.0;
  for (int i = -kSteps + 1; i < kSteps; ++i) {
    for (int j = -kSteps + 1; j < kSteps; ++j) {
      const double x = static_cast<double>(i) / kSteps;
      const double y = static_cast<double>(j) / kSteps;
      const double weight = (1.0 - std::fabs(x)) * (1.0 - std::fabs(y));
      sum += weight * autocorrelation(std::hypot(x, y + rows) / grain_px);
      weights += weight;
    }
  }
  return sum / weights;
}

}  // namespace

float SpeckleNoise::of_sums() const {
  float sum = covariance[0];
  for (int k = 1; k < kSpeckleRows; ++k) sum += 2.0f * covariance[k];
  return sum;
}

SpeckleNoise speckle_noise(const Camera& camera, double wavelength, double contrast) {
  SpeckleNoise noise;
  if (contrast <= 0.0) return noise;
  const double grain_px = camera.grain_px(wavelength);
  for (int k = 0; k < kSpeckleRows; ++k) {
    noise.covariance[k] = static_cast<float>(contrast * contrast * pixel_covariance(grain_px, k));
  }
  return noise;
}

}  // namespace sensor_rt
