// Precomputed speckle pattern.
#pragma once

#include <Eigen/Dense>
#include <cstdint>
#include <memory>
#include <vector>

namespace sensor_rt {

/// Periodic tile of speckle intensity, of mean 1, for a circular aperture. Fully developed speckle is the
/// squared modulus of random waves from a disc; its autocovariance is (2 J1(v) / v)² with v = pi r / grain
/// (Goodman, "Speckle Phenomena in Optics", 2007). A lower contrast C results from incoherent contributions
/// (polarisations, wavelengths, layers of the surface) and is modelled by the mean of 1 / C² independent
/// patterns, which is less skewed than one pattern on a uniform background.
class SpeckleTile {
 public:
  static constexpr int kPerGrain = 8;  ///< steps per grain; a grain is wavelength * working f-number
  static constexpr int kSteps = 1024;

  /// `contrast`: 0..1. At most sixteen patterns are averaged; contrasts below 1/4 add a uniform background.
  explicit SpeckleTile(double contrast);

  /// Returns the shared tile of this contrast, with the mean over a square of `width` steps (0: none) at each
  /// point. The last ones are cached: every batch of exposures asks again.
  static std::shared_ptr<const SpeckleTile> shared(double contrast, double width = 0.0);

  /// Returns the intensity at a point, interpolated between steps; coordinates, in steps, may be negative.
  float at(const Eigen::Vector2d& point) const {
    constexpr double kPositive = kSteps * (1LL << 32);  // a number of tiles, so that truncation is floor
    const double x = point.x() + kPositive;
    const double y = point.y() + kPositive;
    const auto column = static_cast<std::int64_t>(x);
    const auto row = static_cast<std::int64_t>(y);
    const auto u = static_cast<float>(x - static_cast<double>(column));
    const auto v = static_cast<float>(y - static_cast<double>(row));
    const float* above = &steps_[static_cast<std::size_t>((row & (kSteps - 1)) * kSteps)];
    const float* below = &steps_[static_cast<std::size_t>(((row + 1) & (kSteps - 1)) * kSteps)];
    const std::int64_t left = column & (kSteps - 1);
    const std::int64_t right = (column + 1) & (kSteps - 1);
    return (1.0f - v) * ((1.0f - u) * above[left] + u * above[right]) +
           v * ((1.0f - u) * below[left] + u * below[right]);
  }

 private:
  SpeckleTile() = default;
  SpeckleTile averaged(double width) const;

  std::vector<float> steps_;
};

}  // namespace sensor_rt
