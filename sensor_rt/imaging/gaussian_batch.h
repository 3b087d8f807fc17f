// Sixteen Gaussian stripe fits side by side, so that the compiler's vectors run across columns. Internal to
// imaging.
//
// Model of pixel i: m_i = B + S [Phi((i + 1/2 - mu) / sigma) - Phi((i - 1/2 - mu) / sigma)].
// Weights are 1 / (noise variance + model error²): pure noise weights would trust the flanks, where real
// stripes differ from the model. The uncertainty follows from the true noise variance by the sandwich
// formula. For the weights, the variance by speckle grows in proportion to the light, as if it were shot
// noise: with its square the dark flanks would weigh most. Below kNarrowest the pixels cannot tell the width,
// which is then held there.
#pragma once

#include "sensor_rt/imaging/speckle_noise.h"

namespace sensor_rt {

constexpr int kLanes = 16;
constexpr int kMaxRows = 64;
constexpr float kRootTwoPi = 2.50662827f;
constexpr float kNarrowest = 0.3f;  // px

/// One value per column.
struct alignas(64) Lane {
  float v[kLanes];
};

/// Sixteen stripes; intensities are divided by the guessed amplitude, rows counted from the window's first
/// row.
struct GaussianBatch {
  int rows = 0;
  Lane data[kMaxRows];
  Lane mask[kMaxRows];  // 0: outside the window or saturated
  Lane floor, gain, prior, end;
  Lane speckle_weight;  // variance of the brightest pixel by speckle, for the weights
  Lane model_error;     // variance
  Lane mu, sigma, area, background;
  Lane step;                                   // size of the last step in mu and sigma together
  Lane hessian[10], gradient[4];               // packed lower triangle; order mu, sigma, area, background
  Lane he3_gradient[4], he3_norm, he3_misfit;  // third Hermite shape against the model's derivatives
  Lane to_row[4], to_he3[4];                   // solutions of H x = e_mu and H x = he3_gradient
  Lane row_variance, misfit, noise, count;
  Lane cumulative, density;  // at the lower edge of the pixel
  SpeckleNoise speckle;
  // What a change of a pixel in proportion to its light does to row and he3_misfit:
  Lane light_to_row[kMaxRows], light_to_he3[kMaxRows];
  Lane he3_speckle;  // variance of he3_misfit by speckle
};

/// One damped Gauss-Newton step of all lanes. Steps are bounded so that a poor first guess cannot run away.
void iterate(GaussianBatch& batch, float damping);

/// Sums that need the final parameters: normal equations and their product with the third Hermite shape.
void measure_shape(GaussianBatch& batch);

/// Adds speckle to the variances; after measure_noise, which needs its variance in single pixels.
void add_speckle(GaussianBatch& batch);

/// Variance of the centre (sandwich formula) and misfit within two and a half standard deviations; after
/// measure_shape.
void measure_noise(GaussianBatch& batch);

}  // namespace sensor_rt
