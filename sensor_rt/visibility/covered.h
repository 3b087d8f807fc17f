// Coverage: surface samples with a measured point nearby.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace sensor_rt {

/// Positions (count, 3) in metres with unit normals (count, 3).
struct OrientedPoints {
  const double* points = nullptr;
  const double* normals =
      nullptr;  ///< may be null, or NaN for individual points: their normals are not compared
  std::size_t count = 0;
};

/// Returns 1 for each sample with a point of the cloud within `tolerance` (m) whose normal has a cosine of at
/// least `min_cosine` with the sample's, else 0. Points without a normal match either side. Throws
/// std::invalid_argument for samples that are not finite or a tolerance that is not positive; points that are
/// not finite are skipped.
std::vector<std::uint8_t> covered_samples(const OrientedPoints& samples, const OrientedPoints& cloud,
                                          double tolerance, double min_cosine);

}  // namespace sensor_rt
