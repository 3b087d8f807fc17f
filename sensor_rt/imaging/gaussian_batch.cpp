#include "sensor_rt/imaging/gaussian_batch.h"

#include "sensor_rt/geometry/fast_math.h"
#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

using Batch = GaussianBatch;

constexpr float kBackgroundError = 0.1f;  // standard deviation of the Gaussian prior on the background, whose
                                          // mean is 0, relative to the amplitude

/// Pixel-integrated shape and its derivatives with respect to mu, sigma, area, background.
struct Shape {
  float model;
  float d[4];
  float he3;  // third Hermite function with the stripe's height, pixel-integrated
};

inline void first_edge(Batch& b) {
  for (int l = 0; l < kLanes; ++l) {
    const float e = (-0.5f - b.mu.v[l]) / b.sigma.v[l];
    const float exponential = exp_negative(-0.5f * e * e);
    b.cdf.v[l] = normal_cdf(e, exponential);
    b.pdf.v[l] = normal_pdf(exponential);
  }
}

inline Shape shape(Batch& b, int row, int l) {
  const float inverse = 1.0f / b.sigma.v[l];
  const float upper = (static_cast<float>(row) + 0.5f - b.mu.v[l]) * inverse;
  const float lower = (static_cast<float>(row) - 0.5f - b.mu.v[l]) * inverse;
  const float exponential = exp_negative(-0.5f * upper * upper);
  const float cdf = normal_cdf(upper, exponential);
  const float pdf = normal_pdf(exponential);
  const float share = cdf - b.cdf.v[l];
  const float scale = b.area.v[l] * inverse;
  Shape s;
  s.model = b.background.v[l] + b.area.v[l] * share;
  s.d[0] = -scale * (pdf - b.pdf.v[l]);
  s.d[1] = -scale * (upper * pdf - lower * b.pdf.v[l]);
  s.d[2] = share;
  s.d[3] = 1.0f;
  s.he3 = b.area.v[l] * ((lower * lower - 1.0f) * b.pdf.v[l] - (upper * upper - 1.0f) * pdf);
  b.cdf.v[l] = cdf;
  b.pdf.v[l] = pdf;
  return s;
}

/// Noise variance of a pixel, relative to the squared guessed amplitude.
inline float variance(const Batch& b, float model, int l) {
  const float signal = model > 0.0f ? model : 0.0f;
  return b.floor.v[l] + b.gain.v[l] * signal;
}

inline float weight(const Batch& b, float noise, float model, int row, int l) {
  const float signal = model > 0.0f ? model : 0.0f;
  return b.mask[row].v[l] / (noise + b.model_error.v[l] + b.speckle_weight.v[l] * signal);
}

inline void clear_sums(Batch& b) {
  for (int l = 0; l < kLanes; ++l) {
    for (int k = 0; k < 10; ++k) b.hessian[k].v[l] = 0.0f;
    for (int k = 0; k < 4; ++k) b.gradient[k].v[l] = b.he3_gradient[k].v[l] = 0.0f;
    b.he3_norm.v[l] = b.he3_misfit.v[l] = 0.0f;
    b.row_variance.v[l] = b.he3_relative.v[l] = b.misfit.v[l] = b.noise.v[l] = b.count.v[l] = 0.0f;
    const float prior = 1.0f / (kBackgroundError * kBackgroundError);
    b.hessian[9].v[l] = prior;
    b.gradient[3].v[l] = prior * (0.0f - b.background.v[l]);
  }
}

/// Unrolled by hand: the compiler vectorises over the lanes only without inner loops.
inline void add_to_normal_equations(Batch& b, const Shape& s, float w, float misfit, int l) {
  const float w0 = w * s.d[0];
  const float w1 = w * s.d[1];
  const float w2 = w * s.d[2];
  b.hessian[0].v[l] += w0 * s.d[0];
  b.hessian[1].v[l] += w1 * s.d[0];
  b.hessian[2].v[l] += w1 * s.d[1];
  b.hessian[3].v[l] += w2 * s.d[0];
  b.hessian[4].v[l] += w2 * s.d[1];
  b.hessian[5].v[l] += w2 * s.d[2];
  b.hessian[6].v[l] += w0;  // the derivative with respect to the background is 1
  b.hessian[7].v[l] += w1;
  b.hessian[8].v[l] += w2;
  b.hessian[9].v[l] += w;
  b.gradient[0].v[l] += w0 * misfit;
  b.gradient[1].v[l] += w1 * misfit;
  b.gradient[2].v[l] += w2 * misfit;
  b.gradient[3].v[l] += w * misfit;
}

/// Solves H x = g by L D L^T.
inline void solve(const float (&h)[10], const float (&g)[4], float (&x)[4]) {
  const float d0 = h[0];
  const float l10 = h[1] / d0;
  const float l20 = h[3] / d0;
  const float l30 = h[6] / d0;
  const float d1 = h[2] - l10 * h[1];
  const float c21 = h[4] - l20 * h[1];
  const float c31 = h[7] - l30 * h[1];
  const float l21 = c21 / d1;
  const float l31 = c31 / d1;
  const float d2 = h[5] - l20 * h[3] - l21 * c21;
  const float c32 = h[8] - l30 * h[3] - l31 * c21;
  const float l32 = c32 / d2;
  const float d3 = h[9] - l30 * h[6] - l31 * c31 - l32 * c32;
  const float y0 = g[0];
  const float y1 = g[1] - l10 * y0;
  const float y2 = g[2] - l20 * y0 - l21 * y1;
  const float y3 = g[3] - l30 * y0 - l31 * y1 - l32 * y2;
  x[3] = y3 / d3;
  x[2] = y2 / d2 - l32 * x[3];
  x[1] = y1 / d1 - l21 * x[2] - l31 * x[3];
  x[0] = y0 / d0 - l10 * x[1] - l20 * x[2] - l30 * x[3];
}

inline float clamp(float x, float low, float high) {
  const float raised = x < low ? low : x;
  return raised > high ? high : raised;
}

}  // namespace

SENSOR_RT_MULTIVERSION void iterate(Batch& b, float damping) {
  clear_sums(b);
  first_edge(b);
  for (int row = 0; row < b.rows; ++row) {
    for (int l = 0; l < kLanes; ++l) {
      const Shape s = shape(b, row, l);
      const float w = weight(b, variance(b, s.model, l), s.model, row, l);
      add_to_normal_equations(b, s, w, b.data[row].v[l] - s.model, l);
    }
  }
  for (int l = 0; l < kLanes; ++l) {
    float h[10];
    float g[4];
    float x[4];
    for (int k = 0; k < 10; ++k) h[k] = b.hessian[k].v[l];
    for (int k = 0; k < 4; ++k) g[k] = b.gradient[k].v[l];
    h[0] = h[0] * (1.0f + damping) + 1e-12f;
    h[2] = h[2] * (1.0f + damping) + 1e-12f;
    h[5] = h[5] * (1.0f + damping) + 1e-12f;
    solve(h, g, x);
    const float sigma = b.sigma.v[l];
    const float shift = clamp(x[0], -0.7f * sigma, 0.7f * sigma);
    const float widening = clamp(x[1], -0.3f * sigma, 0.4f * sigma);
    b.mu.v[l] = clamp(b.mu.v[l] + shift, -1.0f, b.end.v[l]);
    b.sigma.v[l] = clamp(sigma + widening, kMinSigma, 30.0f);
    const float widened = b.sigma.v[l] - sigma;
    b.area.v[l] = clamp(b.area.v[l] + x[2], 1e-3f, 1e4f);
    b.background.v[l] = clamp(b.background.v[l] + x[3], -10.0f, 10.0f);
    b.step.v[l] = (shift < 0.0f ? -shift : shift) + (widened < 0.0f ? -widened : widened);
  }
}

SENSOR_RT_MULTIVERSION void measure_shape(Batch& b) {
  clear_sums(b);
  first_edge(b);
  for (int row = 0; row < b.rows; ++row) {
    for (int l = 0; l < kLanes; ++l) {
      const Shape s = shape(b, row, l);
      const float w = weight(b, variance(b, s.model, l), s.model, row, l);
      const float misfit = b.data[row].v[l] - s.model;
      add_to_normal_equations(b, s, w, misfit, l);
      for (int k = 0; k < 4; ++k) b.he3_gradient[k].v[l] += w * s.d[k] * s.he3;
      b.he3_norm.v[l] += w * s.he3 * s.he3;
      b.he3_misfit.v[l] += w * s.he3 * misfit;
    }
  }
  for (int l = 0; l < kLanes; ++l) {
    float h[10];
    float g[4];
    float x[4];
    const float row_unit[4] = {1.0f, 0.0f, 0.0f, 0.0f};
    for (int k = 0; k < 10; ++k) h[k] = b.hessian[k].v[l];
    for (int k = 0; k < 4; ++k) g[k] = b.he3_gradient[k].v[l];
    solve(h, g, x);
    for (int k = 0; k < 4; ++k) b.to_he3[k].v[l] = x[k];
    solve(h, row_unit, x);
    for (int k = 0; k < 4; ++k) b.to_row[k].v[l] = x[k];
  }
}

SENSOR_RT_MULTIVERSION void measure_noise(Batch& b) {
  const float pattern = b.pattern;
  const float speckle = b.speckle.covariance[0];
  first_edge(b);
  for (int row = 0; row < b.rows; ++row) {
    for (int l = 0; l < kLanes; ++l) {
      const Shape s = shape(b, row, l);
      const float noise = variance(b, s.model, l);
      const float w = weight(b, noise, s.model, row, l);
      float influence = 0.0f;
      float explained = 0.0f;
      for (int k = 0; k < 4; ++k) {
        influence += b.to_row[k].v[l] * s.d[k];
        explained += b.to_he3[k].v[l] * s.d[k];
      }
      const float light = b.area.v[l] * s.d[2];
      const float to_row = w * influence * light;
      const float to_he3 = w * (s.he3 - explained) * light;
      b.light_to_row[row].v[l] = to_row;
      b.light_to_he3[row].v[l] = to_he3;
      b.row_variance.v[l] += w * w * influence * influence * noise + pattern * to_row * to_row;
      b.he3_relative.v[l] += pattern * to_he3 * to_he3;
      const float z = (static_cast<float>(row) - b.mu.v[l]) / b.sigma.v[l];
      const float inside = z * z < 6.25f ? b.mask[row].v[l] : 0.0f;
      const float misfit = b.data[row].v[l] - s.model;
      b.misfit.v[l] += inside * misfit * misfit;
      b.noise.v[l] += inside * (noise + (pattern + speckle) * light * light);
      b.count.v[l] += inside;
    }
  }
}

SENSOR_RT_MULTIVERSION void add_speckle(Batch& b) {
  for (int apart = 0; apart < kSpeckleRows; ++apart) {
    const float covariance = (apart == 0 ? 1.0f : 2.0f) * b.speckle.covariance[apart];
    for (int row = 0; row + apart < b.rows; ++row) {
      for (int l = 0; l < kLanes; ++l) {
        b.row_variance.v[l] += covariance * b.light_to_row[row].v[l] * b.light_to_row[row + apart].v[l];
        b.he3_relative.v[l] += covariance * b.light_to_he3[row].v[l] * b.light_to_he3[row + apart].v[l];
      }
    }
  }
}

}  // namespace sensor_rt
