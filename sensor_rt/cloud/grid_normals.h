// Normals from the grid of profiles and columns.
#pragma once

#include <vector>

#include "sensor_rt/cloud/profile_rows.h"

namespace sensor_rt {

/// Cosine between normal and light below which a plane is regarded as the laser sheet itself.
constexpr double kMinCosine = 0.02;

/// Largest distance of neighbours, m.
constexpr double kMaxNeighbourDistance = 10e-3;

/// A point without a lit normal from its grid neighbours, and the direction of its profile there; NaN:
/// unknown.
struct UnresolvedPoint {
  std::uint32_t index;
  Eigen::Vector3d along;
};

/// Writes unit normals (count, 3) towards the light where a point's neighbours in its profile and in the
/// adjacent profiles define a surface. Returns the other points in ascending order; their normals are not
/// written.
///
/// The direction along the profile is the slope of a line fitted through up to six columns on either side,
/// the direction across is the mean of the steps to the previous and the next frame. Both use unbroken chains
/// of short steps: shorter than `kMaxNeighbourDistance` and than four times the median step of the camera in
/// the block of 400 frames that contains the point and one frame on either side.
std::vector<UnresolvedPoint> grid_normals(const CloudView& cloud, const ProfileRows& rows, unsigned threads,
                                          double* normals);

}  // namespace sensor_rt
