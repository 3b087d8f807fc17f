// Precomputed speckle pattern.
#pragma once

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

  /// Returns the shared tile of this contrast; the last one is cached.
  static std::shared_ptr<const SpeckleTile> shared(double contrast);

  /// Returns the intensity at a step; coordinates may be negative.
  float at(std::int64_t x, std::int64_t y) const {
    return steps_[static_cast<std::size_t>((y & (kSteps - 1)) * kSteps + (x & (kSteps - 1)))];
  }

 private:
  std::vector<float> steps_;
};

}  // namespace sensor_rt
