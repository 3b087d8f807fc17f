#include "sensor_rt/imaging/column_window.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {
namespace {

constexpr double kPixelVariance = 1.0 / 12.0;
constexpr double kDark = 0.5;        // DN: a pixel without stripe
constexpr float kShapeReach = 3.0f;  // standard deviations to either side in a typical window

/// Subtracts the smaller of the signals at the ends: the halo of a stripe would govern
/// the moments.
void remove_halo(ColumnWindow& w) {
  const double halo = std::max(0.0, std::min(w.signal[0], w.signal[w.count - 1]));
  for (int i = 0; i < w.count; ++i) w.signal[i] -= halo;
}

}  // namespace

ColumnWindow gather(ImageRows image, const PixelNoise& noise, const Candidate& candidate, double reach) {
  RowWindow rows = window(candidate, static_cast<float>(reach), image.height);
  rows.last = std::min(rows.last, rows.first + kWindowRows - 1);
  const auto relative = static_cast<double>(noise.relative_of_sums());
  ColumnWindow w;
  w.first = rows.first;
  w.count = std::max(0, rows.last - rows.first + 1);
  for (int i = 0; i < w.count; ++i) {
    const auto value = static_cast<float>(image.at(rows.first + i, candidate.column));
    w.signal[i] = static_cast<double>(value - candidate.background_at(rows.first + i));
    const double light = std::max(0.0, w.signal[i]);
    w.variance[i] = noise.variance(w.signal[i]) + static_cast<double>(candidate.light_variance) +
                    relative * light * light;
    w.clipped[i] = !(value < noise.saturation);
  }
  return w;
}

double summit(const ColumnWindow& w) {
  int highest = 0;
  int first_clipped = w.count;
  int last_clipped = -1;
  for (int i = 0; i < w.count; ++i) {
    if (w.signal[i] > w.signal[highest]) highest = i;
    if (!w.clipped[i]) continue;
    first_clipped = std::min(first_clipped, i);
    last_clipped = i;
  }
  return last_clipped < 0 ? highest : 0.5 * (first_clipped + last_clipped);
}

void measure_moments(const ColumnWindow& w, const Candidate& c, StripeFit& fit) {
  double sum = 0.0;
  double moment = 0.0;
  bool saturated = false;
  for (int i = 0; i < w.count; ++i) {
    sum += w.signal[i];
    moment += w.signal[i] * i;
    saturated = saturated || w.clipped[i];
  }
  sum = std::max(sum, 1e-6);
  const double centre = std::clamp(moment / sum, 0.0, std::max(0.0, w.count - 1.0));
  double second = 0.0;
  double third = 0.0;
  double centre_variance = 0.0;
  for (int i = 0; i < w.count; ++i) {
    const double d = i - centre;
    second += w.signal[i] * d * d / sum;
    third += w.signal[i] * d * d * d / sum;
    centre_variance += w.variance[i] * d * d / (sum * sum);
  }
  const double width = std::sqrt(std::max(1e-4, second - kPixelVariance));
  fit.width = static_cast<float>(width);
  fit.amplitude = static_cast<float>(sum / (width * std::sqrt(2.0 * std::acos(-1.0))));
  fit.asymmetry = static_cast<float>(third / (6.0 * width * width * width));
  // The noise of a third moment over the window exceeds that of the centre by about the square of the window
  // size.
  fit.asymmetry_sigma =
      static_cast<float>(std::sqrt(centre_variance) / (6.0 * width)) * kShapeReach * kShapeReach;
  fit.residual = 0.0f;  // moments have no model to compare with
  fit.residual_noise = 0.0f;
  fit.flags = c.flags | (saturated ? kPeakSaturated : 0u);
}

ColumnWindow measure_moments(ImageRows image, const PixelNoise& noise, const Candidate& c, StripeFit& fit) {
  constexpr double kMargin = 1.0;  // rows
  ColumnWindow w =
      gather(image, noise, c, static_cast<double>(kShapeReach) * static_cast<double>(c.width) + kMargin);
  if (c.has_halo && w.count > 0) remove_halo(w);
  measure_moments(w, c, fit);
  return w;
}

void set_row(const ColumnWindow& w, const Candidate& c, double offset, double variance, StripeFit& fit) {
  if (offset >= -1.0 && offset <= w.count && std::isfinite(variance)) {
    fit.row = w.first + offset;
    fit.row_sigma = static_cast<float>(std::sqrt(variance));
  } else {
    fit.row = static_cast<double>(c.row);
    fit.row_sigma = c.width;
    fit.flags |= kPeakNotConverged;
  }
}

}  // namespace sensor_rt
