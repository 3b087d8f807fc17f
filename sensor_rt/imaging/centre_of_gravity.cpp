// Stripe centre as the centre of gravity of the signal above the background. Simple and unbiased on clean
// stripes, but pulled by anything else in the window; there is no model, so the residual stays 0.
#include <algorithm>
#include <cmath>

#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {
namespace {

constexpr float kReach = 3.0f;        // half window, in standard deviations ...
constexpr float kReachMargin = 1.0f;  // ... plus rows
constexpr double kPixelVariance = 1.0 / 12.0;

struct Moments {
  double sum = 0.0;
  double centre = 0.0;
  double second = 0.0;
  double third = 0.0;
  double centre_variance = 0.0;
  bool saturated = false;
};

Moments moments(ImageRows image, const PixelNoise& noise, int column, const RowWindow& rows) {
  Moments m;
  const auto signal = [&](int y) {
    return static_cast<double>(image.at(y, column)) - static_cast<double>(noise.background);
  };
  for (int y = rows.first; y <= rows.last; ++y) {
    m.sum += signal(y);
    m.centre += signal(y) * (y - rows.first);
    if (static_cast<float>(image.at(y, column)) >= noise.saturation) m.saturated = true;
  }
  m.sum = std::max(m.sum, 1e-6);
  m.centre = rows.first + std::clamp(m.centre / m.sum, 0.0, static_cast<double>(rows.last - rows.first));
  for (int y = rows.first; y <= rows.last; ++y) {
    const double d = y - m.centre;
    m.second += signal(y) * d * d / m.sum;
    m.third += signal(y) * d * d * d / m.sum;
    const double variance = noise.variance_floor + noise.gain * std::max(0.0, signal(y));
    m.centre_variance += variance * d * d / (m.sum * m.sum);
  }
  return m;
}

}  // namespace

void locate_centre_of_gravity(ImageRows image, const PixelNoise& noise, const Candidate* candidates,
                              std::size_t count, StripeFit* fits) {
  for (std::size_t i = 0; i < count; ++i) {
    const Candidate& c = candidates[i];
    const Moments m =
        moments(image, noise, c.column, window(c, kReach * c.width + kReachMargin, image.height));
    const double width = std::sqrt(std::max(1e-4, m.second - kPixelVariance));
    StripeFit& fit = fits[i];
    fit.row = m.centre;
    fit.width = static_cast<float>(width);
    fit.amplitude = static_cast<float>(m.sum / (width * std::sqrt(2.0 * std::acos(-1.0))));
    fit.row_sigma = static_cast<float>(std::sqrt(m.centre_variance));
    fit.asymmetry = static_cast<float>(m.third / (6.0 * width * width * width));
    // A third moment over the window is noisier than the centre by about the square of the reach.
    fit.asymmetry_sigma = fit.row_sigma * kReach * kReach / (6.0f * fit.width);
    fit.residual = 0.0f;
    fit.residual_noise = 0.0f;
    fit.flags = c.flags | (m.saturated ? kPeakSaturated : 0u);
  }
}

}  // namespace sensor_rt
