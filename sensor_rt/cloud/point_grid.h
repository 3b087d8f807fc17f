// Nearest-neighbour search among points on surfaces.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/cloud/cloud_view.h"
#include "sensor_rt/geometry/large_vector.h"

namespace sensor_rt {

struct Neighbour {
  double distance2;  ///< m²
  std::uint32_t index;

  bool operator<(const Neighbour& other) const {
    return distance2 != other.distance2 ? distance2 < other.distance2 : index < other.index;
  }
};

/// Hash grid of every `stride`-th point of a cloud, with cubic cells.
class PointGrid {
 public:
  /// `low` is the lower corner of the cloud, `cell` the edge of the cubes, m.
  PointGrid(const CloudView& cloud, const Eigen::Vector3d& low, std::size_t stride, double cell,
            unsigned threads);

  /// Finds the `most` nearest points of `from`, a point of the cloud, sorted by distance; fewer if there are
  /// no more within `radius`. Returns false when some of them may lie more than five cells away.
  bool search(const Eigen::Vector3d& from, std::size_t most, double radius,
              std::vector<Neighbour>& found) const;

 private:
  /// Cell index along each axis.
  using Cell = Eigen::Array<std::int64_t, 3, 1>;

  Cell cell_of(const Eigen::Vector3d& point) const {
    return ((point - low_) * per_cell_).array().cast<std::int64_t>();
  }
  std::size_t bucket_of(const Cell& cell) const;

  const CloudView& cloud_;
  Eigen::Vector3d low_;
  double cell_;
  double per_cell_;  ///< 1 / cell_
  std::size_t mask_;
  std::vector<std::uint32_t> begin_;  ///< first point of each bucket in points_, and the end of the last
  LargeVector<std::uint32_t> points_;
};

/// Returns the bounding box of a cloud.
Eigen::AlignedBox3d bounds_of(const CloudView& cloud);

}  // namespace sensor_rt
