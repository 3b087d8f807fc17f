// One piece of speckle, made once.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

namespace sensor_rt {

/// Intensity of speckle behind a circular aperture, of mean 1, on a square that repeats. Fully developed, it
/// is the squared modulus of a field of random waves from within a disc, whose autocovariance is (2 J1(v) /
/// v)² with v = pi r / grain (Goodman, "Speckle Phenomena in Optics", 2007). Less contrast C comes of light
/// that does not interfere (polarisations, wavelengths, layers of the surface): of the mean of 1 / C²
/// independent patterns. Such light is less skew than one pattern over even ground.
class GrainTile {
 public:
  static constexpr int kPerGrain = 8;  ///< steps per grain, wavelength * working f-number
  static constexpr int kSteps = 1024;

  /// `contrast`: 0..1. From sixteen patterns on, below 1/4, the ground is even after all.
  explicit GrainTile(double contrast);

  /// The tile that all with this contrast share; the one asked for last is kept.
  static std::shared_ptr<const GrainTile> shared(double contrast);

  /// Intensity at the nearest step; places count in steps and may be negative.
  float at(std::int64_t x, std::int64_t y) const {
    return steps_[static_cast<std::size_t>((y & (kSteps - 1)) * kSteps + (x & (kSteps - 1)))];
  }

 private:
  std::vector<float> steps_;
};

}  // namespace sensor_rt
