// Sixteen Gaussian stripe fits at a time, vectorised over the columns. Internal to imaging.
//
// Model of pixel i: m_i = B + S [Phi((i + 1/2 - mu) / sigma) - Phi((i - 1/2 - mu) / sigma)].
// Weights are 1 / (noise variance + model error²): with pure noise weights the fit would depend on the
// flanks, where real stripes differ from the model. The uncertainty follows from the true noise variance by
// the sandwich formula. In the weights, the speckle variance is proportional to the light, like shot noise:
// with its square the dark flanks would dominate; the pixel sensitivities are covered by the model error.
// Below kMinSigma the width is not observable and held constant.
#pragma once

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/imaging/speckle_noise.h"

namespace sensor_rt {

constexpr int kMaxRows = 64;
constexpr float kRootTwoPi = 2.50662827f;
constexpr float kMinSigma = 0.3f;  // px

/// One value per column.
struct alignas(64) Lane {
  float v[kLanes];
};

/// Data of sixteen stripes; intensities are divided by the guessed amplitude, rows count from the first row
/// of the window.
struct GaussianBatch {
  int rows = 0;
  Lane data[kMaxRows];
  Lane mask[kMaxRows];  // 0: outside the window or saturated
  Lane floor, gain, end;
  Lane speckle_weight;  // speckle variance of the brightest pixel, for the weights
  Lane model_error;     // variance
  Lane mu, sigma, area, background;
  Lane step;                      // size of the last step in mu and sigma together
  Lane hessian[10], gradient[4];  // packed lower triangle; order mu, sigma, area, background
  Lane he3_gradient[4], he3_norm,
      he3_misfit;             // projection of the third Hermite function onto the model's derivatives
  Lane to_row[4], to_he3[4];  // solutions of H x = e_mu and H x = he3_gradient
  Lane row_variance, misfit, noise, count;
  Lane cdf, pdf;         // at the lower edge of the pixel
  float pattern = 0.0f;  // variance of the relative pixel sensitivities
  SpeckleNoise speckle;
  // Sensitivity of row and he3_misfit to a relative change of a pixel:
  Lane light_to_row[kMaxRows], light_to_he3[kMaxRows];
  Lane he3_relative;  // variance of he3_misfit due to pixel sensitivities and speckle
};

/// Performs one damped Gauss-Newton step in all lanes. Steps are bounded so that a poor first guess does not
/// diverge.
void iterate(GaussianBatch& batch, float damping);

/// Computes the sums that need the final parameters: normal equations and their product with the third
/// Hermite function.
void measure_shape(GaussianBatch& batch);

/// Adds the speckle to the variances. Call after measure_noise, which needs the variance of single pixels.
void add_speckle(GaussianBatch& batch);

/// Computes the variance of the centre (sandwich formula) and the misfit within 2.5 standard deviations. Call
/// after measure_shape.
void measure_noise(GaussianBatch& batch);

}  // namespace sensor_rt
