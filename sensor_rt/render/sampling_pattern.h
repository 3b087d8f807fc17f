// Sample positions within a pixel, an exposure, the laser source and the lens.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/geometry/lanes.h"

namespace sensor_rt {

/// Rank-1 lattice over row, column, time, source and lens: the projection of n samples onto each dimension
/// has n distinct values. Stripes run along the columns, so that every sample of a pixel sees a different
/// height of the stripe profile and the integral over a smooth stripe is exact far below the noise. All
/// pixels share the pattern.
struct SamplingPattern {
  std::vector<double> column;  ///< offset from the pixel centre, in (-0.5, 0.5)
  std::vector<double> row;
  std::vector<std::size_t> instant;  ///< stratum of the exposure, 0 .. n - 1
  std::vector<double> source;        ///< position along the laser source, in (-0.5, 0.5)
  std::vector<double> lens_x;        ///< position on the lens, a disc of radius 1
  std::vector<double> lens_y;

  std::size_t size() const { return row.size(); }
  /// Returns the size rounded up to full packets.
  std::size_t padded_size() const { return (size() + kLanes - 1) / kLanes * kLanes; }
  /// Returns the sample of a lane of the padded packets: all samples in turn, because photons use every lane.
  std::size_t sample_of(std::size_t lane) const { return lane % size(); }
};

SamplingPattern make_sampling_pattern(std::size_t samples);

/// Returns the offset from the pixel centre below which the fraction `share` of the light of a pixel lies
/// whose edges are blurred by a Gaussian.
double blurred_pixel_quantile(double share, double sigma_px);

/// Returns the x below which the fraction `share` of the standard normal distribution lies.
double normal_quantile(double share);

/// Returns the centres of n equal strata of the exposure, as fractions.
std::vector<double> instants_of_exposure(std::size_t samples);

}  // namespace sensor_rt
