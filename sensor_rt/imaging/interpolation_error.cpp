#include "sensor_rt/imaging/interpolation_error.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace sensor_rt {
namespace {

constexpr double kNarrowest = 0.3;  // px
constexpr double kWidest = 8.0;
constexpr int kPositions = 16;
constexpr int kRows = 64;
constexpr double kHeight = 50'000.0;  // DN: rounding is negligible

/// Returns the error (px) for a stripe at `centre` in an image of one column; NaN when it is not located.
double error_at(LocateFunction& locate, double centre, double width) {
  std::vector<std::uint16_t> image(kRows);
  const auto below = [&](double row) { return 0.5 * (1.0 + std::erf((row - centre) / (width * M_SQRT2))); };
  const double area = kHeight * width * std::sqrt(2.0 * M_PI);
  Candidate candidate;
  candidate.upper_limit = kRows - 1;
  candidate.first_row = kRows;
  for (int y = 0; y < kRows; ++y) {
    const double light = area * (below(y + 0.5) - below(y - 0.5));
    image[static_cast<std::size_t>(y)] = static_cast<std::uint16_t>(std::min(65'000.0, std::round(light)));
    if (light < 0.01 * kHeight) continue;
    candidate.first_row = std::min(candidate.first_row, y);
    candidate.last_row = y;
  }
  PixelNoise noise;
  noise.variance_floor = noise.dark_variance = 1.0f;
  noise.saturation = 65'535.0f;
  const ImageRows rows{image.data(), 1, kRows, 1};
  estimate_shape(rows, noise, static_cast<float>(kWidest), candidate);
  StripeFit fit;
  locate(rows, noise, &candidate, 1, &fit);
  return (fit.flags & kPeakNotConverged) != 0 ? NAN : fit.row - centre;
}

}  // namespace

InterpolationError::InterpolationError(LocateFunction& locate) {
  for (int k = 0; k < kWidths; ++k) {
    const double width = kNarrowest * std::pow(kWidest / kNarrowest, static_cast<double>(k) / (kWidths - 1));
    double sum = 0.0;
    int found = 0;
    for (int i = 0; i < kPositions; ++i) {
      const double error = error_at(locate, kRows / 2 + (i + 0.5) / kPositions, width);
      if (!std::isfinite(error)) continue;
      sum += error * error;
      ++found;
    }
    error_[k] = static_cast<float>(std::sqrt(sum / std::max(1, found)));
  }
}

float InterpolationError::at(float width) const {
  const auto narrowest = static_cast<float>(kNarrowest);
  const float steps = std::log(std::max(width, narrowest) / narrowest) /
                      static_cast<float>(std::log(kWidest / kNarrowest)) * static_cast<float>(kWidths - 1);
  const int before = std::min(static_cast<int>(steps), kWidths - 2);
  const float share = std::min(1.0f, steps - static_cast<float>(before));
  return (1.0f - share) * error_[before] + share * error_[before + 1];
}

}  // namespace sensor_rt
