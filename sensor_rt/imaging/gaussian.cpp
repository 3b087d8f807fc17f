// Stripe centre by weighted least squares with a pixel-integrated Gaussian on a constant background;
// saturated pixels are left out.
#include <algorithm>
#include <cmath>

#include "sensor_rt/imaging/gaussian_batch.h"
#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {
namespace {

constexpr int kIterations = 12;
constexpr int kSlowIterations = 24;     // speckled stripes and those with a halo converge slowly
constexpr float kReach = 3.5f;          // half window, in standard deviations ...
constexpr float kReachMargin = 1.5f;    // ... plus rows
constexpr float kFlankReach = 2.5f;     // the same with a halo, which outweighs the outer flanks
constexpr float kMostLogHeight = 5.0f;  // of the first guess of a saturated stripe, over the saturation
constexpr float kModelError = 0.01f;    // of the amplitude
// A saturated stripe is located by its flanks alone: a smaller model error gives them enough weight.
constexpr float kSaturatedModelError = 0.002f;
constexpr float kShapeless = 0.36f;       // px: width below which the skewness is not measurable
constexpr float kHeldError = 0.05f;       // px: position error due to the fixed width of narrower stripes
constexpr float kConvergedStep = 2e-4f;   // px: largest last step of a converged fit ...
constexpr float kConvergedShare = 0.01f;  // ... or this share of the standard deviation

void load(ImageRows image, const PixelNoise& noise, const Candidate& c, GaussianBatch& b, int l,
          RowWindow& rows) {
  const float scale = 1.0f / c.amplitude;
  const bool flat = c.flat_top > 0.0f;
  // The recorded signal is as wide as the light and the flat top together.
  const float width = flat ? std::sqrt(c.width * c.width - c.flat_top * c.flat_top / 3.0f) : c.width;
  const float reach = c.has_halo ? std::hypot(kFlankReach * width, c.flat_top) : kReach * width;
  rows = window(c, reach + kReachMargin, image.height);
  rows.last = std::min(rows.last, rows.first + kMaxRows - 1);
  bool saturated = false;
  for (int y = rows.first; y <= rows.last; ++y) {
    const auto value = static_cast<float>(image.at(y, c.column));
    b.data[y - rows.first].v[l] = value * scale - c.background_at(y) * scale;
    b.mask[y - rows.first].v[l] = value < noise.saturation ? 1.0f : 0.0f;
    saturated = saturated || !(value < noise.saturation);
  }
  const float model_error = saturated ? kSaturatedModelError : kModelError;
  b.model_error.v[l] = model_error * model_error;
  b.floor.v[l] = (noise.variance_floor + c.light_variance) * scale * scale;
  b.gain.v[l] = noise.gain * scale;
  b.speckle_weight.v[l] = noise.speckle.covariance[0];
  b.end.v[l] = static_cast<float>(rows.last - rows.first + 1);
  b.mu.v[l] = c.row - static_cast<float>(rows.first);
  b.sigma.v[l] = std::clamp(width, kMinSigma + 0.1f, 10.0f);
  b.area.v[l] = b.sigma.v[l] * kRootTwoPi;
  if (flat) {
    b.area.v[l] *= std::exp(std::min(kMostLogHeight, 0.5f * c.flat_top * c.flat_top / (width * width)));
  }
  b.background.v[l] = 0.0f;
  b.rows = std::max(b.rows, rows.last - rows.first + 1);
}

bool is_finite(const StripeFit& fit) {
  return std::isfinite(fit.row) && std::isfinite(fit.amplitude) && std::isfinite(fit.row_sigma) &&
         std::isfinite(fit.asymmetry) && std::isfinite(fit.asymmetry_sigma) && std::isfinite(fit.residual);
}

/// Returns the result for a failed fit, for example when nearly all pixels are saturated: the first guess.
StripeFit unfitted(const Candidate& c) {
  StripeFit fit;
  fit.row = static_cast<double>(c.row);
  fit.amplitude = c.amplitude;
  fit.width = c.width;
  fit.row_sigma = c.width;
  fit.flags = c.flags | kPeakNotConverged;
  return fit;
}

StripeFit result(const Candidate& c, const GaussianBatch& b, int l, const RowWindow& rows) {
  StripeFit fit;
  const float relative_amplitude = b.area.v[l] / (b.sigma.v[l] * kRootTwoPi);
  fit.row = static_cast<double>(rows.first) + static_cast<double>(b.mu.v[l]);
  fit.amplitude = relative_amplitude * c.amplitude;
  fit.width = b.sigma.v[l];
  fit.row_sigma = std::sqrt(b.row_variance.v[l]);
  float explained = 0.0f;
  for (int k = 0; k < 4; ++k) explained += b.he3_gradient[k].v[l] * b.to_he3[k].v[l];
  const float information = std::max(b.he3_norm.v[l] - explained, 1e-6f * b.he3_norm.v[l] + 1e-12f);
  fit.asymmetry = b.he3_misfit.v[l] / information;
  fit.asymmetry_sigma = std::sqrt(1.0f + b.he3_relative.v[l] / information) / std::sqrt(information);
  if (fit.width < kShapeless) fit.asymmetry = 0.0f;
  if (fit.width <= kMinSigma) fit.row_sigma = std::hypot(fit.row_sigma, kHeldError);
  const float count = std::max(b.count.v[l], 1.0f);
  fit.residual = std::sqrt(std::max(0.0f, b.misfit.v[l] - b.noise.v[l]) / count) / relative_amplitude;
  fit.residual_noise = std::sqrt(b.noise.v[l] / count) / relative_amplitude;
  fit.flags = c.flags;
  const float converged =
      std::max(kConvergedStep * std::max(1.0f, b.sigma.v[l]), kConvergedShare * fit.row_sigma);
  if (b.step.v[l] > converged) fit.flags |= kPeakNotConverged;
  if (!is_finite(fit)) fit = unfitted(c);
  for (int y = 0; y <= rows.last - rows.first; ++y) {
    if (b.mask[y].v[l] == 0.0f) fit.flags |= kPeakSaturated;
  }
  const float near = 2.5f * fit.width;
  if ((c.lower_limit > 0 && static_cast<float>(fit.row) - near < static_cast<float>(c.lower_limit)) ||
      (c.flags & kPeakMultiple && static_cast<float>(fit.row) + near > static_cast<float>(c.upper_limit))) {
    fit.flags |= kPeakOverlap;
  }
  return fit;
}

}  // namespace

void locate_gaussian(ImageRows image, const PixelNoise& noise, const Candidate* candidates, std::size_t count,
                     StripeFit* fits) {
  for (std::size_t begin = 0; begin < count; begin += kLanes) {
    GaussianBatch b{};
    b.pattern = noise.pattern;
    b.speckle = noise.speckle;
    RowWindow rows[kLanes];
    const std::size_t lanes = std::min<std::size_t>(kLanes, count - begin);
    bool halo = false;
    for (int l = 0; l < kLanes; ++l) {  // unused lanes repeat the last stripe
      const Candidate& c = candidates[begin + std::min<std::size_t>(static_cast<std::size_t>(l), lanes - 1)];
      load(image, noise, c, b, l, rows[l]);
      halo = halo || c.has_halo;
    }
    const int iterations = noise.speckle.enabled() || halo ? kSlowIterations : kIterations;
    float largest = 1.0f;
    float damping = 1e-2f;
    for (int i = 0; i < iterations && largest > 0.2f * kConvergedStep; ++i, damping *= 0.1f) {
      iterate(b, damping);
      largest = *std::max_element(b.step.v, b.step.v + kLanes);
    }
    measure_shape(b);
    measure_noise(b);
    if (b.speckle.enabled()) add_speckle(b);
    for (std::size_t l = 0; l < lanes; ++l) {
      fits[begin + l] = result(candidates[begin + l], b, static_cast<int>(l), rows[l]);
    }
  }
}

}  // namespace sensor_rt
