// One piece of fully developed speckle, made once.
#pragma once

#include <cstdint>
#include <vector>

namespace sensor_rt {

/// Intensity of fully developed speckle behind a circular aperture, of mean 1 and contrast 1, on a square
/// that repeats: the squared modulus of a field of random waves from within a disc, whose autocovariance is
/// (2 J1(v) / v)² with v = pi r / grain (Goodman, "Speckle Phenomena in Optics", 2007).
class GrainTile {
 public:
  static constexpr int kPerGrain = 8;  ///< steps per grain, wavelength * working f-number
  static constexpr int kSteps = 1024;

  /// The tile that all share.
  static const GrainTile& shared();

  /// Intensity at the nearest step; places count in steps and may be negative.
  float at(std::int64_t x, std::int64_t y) const {
    return steps_[static_cast<std::size_t>((y & (kSteps - 1)) * kSteps + (x & (kSteps - 1)))];
  }

 private:
  GrainTile();

  std::vector<float> steps_;
};

}  // namespace sensor_rt
