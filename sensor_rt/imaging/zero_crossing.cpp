// Stripe centre as the zero crossing of a derivative filter: Blais and Rioux's box filters, or the derivative
// of a Gaussian as wide as the stripe, which is the matched filter.
#include <algorithm>
#include <cmath>

#include "sensor_rt/imaging/column_window.h"

namespace sensor_rt {
namespace {

constexpr double kShapeReach = 3.0;
constexpr int kNewtonSteps = 8;
constexpr double kMinKernelSigma = 0.8;  // px; narrower kernels respond to single pixels
constexpr double kMaxKernelSigma = 8.0;

/// Returns the sum of the `half` rows before row i minus those after it.
double box_difference(const ColumnWindow& w, int i, int half) {
  double difference = 0.0;
  for (int k = 1; k <= half; ++k) difference += w.at(i - k) - w.at(i + k);
  return difference;
}

/// Returns the rows closest to the peak between which the filter output rises through zero; -1: none.
int crossing(const ColumnWindow& w, double top, int half) {
  int best = -1;
  for (int i = 0; i + 1 < w.count; ++i) {
    if (box_difference(w, i, half) > 0.0 || box_difference(w, i + 1, half) <= 0.0) continue;
    if (best < 0 || std::fabs(i + 0.5 - top) < std::fabs(best + 0.5 - top)) best = i;
  }
  return best;
}

void locate_by_boxes(ImageRows image, const PixelNoise& noise, const Candidate* candidates, std::size_t count,
                     StripeFit* fits, int half) {
  for (std::size_t k = 0; k < count; ++k) {
    const Candidate& c = candidates[k];
    const ColumnWindow w =
        gather(image, noise, c, std::max(kShapeReach * static_cast<double>(c.width), half + 1.0) + 1.0);
    measure_moments(w, c, fits[k]);
    const int i = crossing(w, summit(w), half);
    if (i < 0) {
      set_row(w, c, NAN, 0.0, fits[k]);
      continue;
    }
    const double before = box_difference(w, i, half);
    const double rise = box_difference(w, i + 1, half) - before;
    const double share = -before / rise;
    double variance = 0.0;
    for (int r = 0; r < w.count; ++r) {
      const auto sign = [&](int centre) {
        const int d = r - centre;
        return std::abs(d) <= half ? (d < 0) - (d > 0) : 0;
      };
      const double influence = ((1.0 - share) * sign(i) + share * sign(i + 1)) / rise;
      variance += influence * influence * w.variance[r];
    }
    set_row(w, c, i + share, variance, fits[k]);
  }
}

/// Solves sum (i - x) exp(-(i - x)² / (2 s²)) signal_i = 0 from `start`; returns NaN on divergence.
double gaussian_crossing(const ColumnWindow& w, double start, double s, double& variance) {
  double x = start;
  double step = 0.0;
  for (int iteration = 0; iteration < kNewtonSteps; ++iteration) {
    double value = 0.0;
    double slope = 0.0;
    variance = 0.0;
    for (int i = 0; i < w.count; ++i) {
      const double z = (i - x) / s;
      const double g = std::exp(-0.5 * z * z);
      value += z * g * w.signal[i];
      slope += (z * z - 1.0) * g * w.signal[i] / s;
      variance += z * z * g * g * w.variance[i];
    }
    variance /= slope * slope;
    if (slope >= 0.0) return NAN;  // not a maximum
    step = std::clamp(-value / slope, -s, s);
    x += step;
    if (std::fabs(step) < 1e-5) break;
  }
  return std::fabs(step) < 1e-3 ? x : NAN;
}

}  // namespace

void locate_blais_rioux_4(ImageRows image, const PixelNoise& noise, const Candidate* candidates,
                          std::size_t count, StripeFit* fits) {
  locate_by_boxes(image, noise, candidates, count, fits, 2);
}

void locate_blais_rioux_8(ImageRows image, const PixelNoise& noise, const Candidate* candidates,
                          std::size_t count, StripeFit* fits) {
  locate_by_boxes(image, noise, candidates, count, fits, 4);
}

void locate_derivative_of_gaussian(ImageRows image, const PixelNoise& noise, const Candidate* candidates,
                                   std::size_t count, StripeFit* fits) {
  for (std::size_t k = 0; k < count; ++k) {
    const Candidate& c = candidates[k];
    const double s = std::clamp(static_cast<double>(c.width), kMinKernelSigma, kMaxKernelSigma);
    const ColumnWindow w = gather(image, noise, c, 4.0 * s + 1.0);
    measure_moments(image, noise, c, fits[k]);
    double variance = 0.0;
    const double x = gaussian_crossing(w, static_cast<double>(c.row) - w.first, s, variance);
    set_row(w, c, x, variance, fits[k]);
  }
}

}  // namespace sensor_rt
