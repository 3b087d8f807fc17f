// Where in a pixel and when in an exposure the samples lie.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/geometry/lanes.h"

namespace sensor_rt {

/// A rank-1 lattice over row, column, time, the laser's opening and the lens: n samples take n different
/// rows, n different columns and so on. Stripes run along columns, so that every sample of a pixel sees
/// another height of the stripe and the integral over a smooth stripe is exact to far below the noise. The
/// pattern is the same in every pixel.
struct SamplingPattern {
  std::vector<double> column;  ///< offset from the pixel centre, in (-0.5, 0.5)
  std::vector<double> row;
  std::vector<std::size_t> instant;  ///< stratum of the exposure, 0 .. n - 1
  std::vector<double> source;        ///< place along the laser's opening, in (-0.5, 0.5)
  std::vector<double> lens_x;        ///< place on the lens, a disc of radius 1
  std::vector<double> lens_y;

  std::size_t size() const { return row.size(); }
  /// Rounded up to whole packets.
  std::size_t padded_size() const { return (size() + kLanes - 1) / kLanes * kLanes; }
};

SamplingPattern make_sampling_pattern(std::size_t samples);

/// Offset from a pixel's centre below which lies the share `share` of the light of a pixel whose edges are
/// blurred by a Gaussian.
double blurred_pixel_quantile(double share, double sigma_px);

/// Middles of n equal strata of the exposure, as fractions.
std::vector<double> instants_of_exposure(std::size_t samples);

}  // namespace sensor_rt
