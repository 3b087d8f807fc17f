#include "sensor_rt/cloud/point_grid.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/geometry/parallel.h"
#include "sensor_rt/geometry/random.h"

namespace sensor_rt {
namespace {

constexpr int kRings = 5;  // of cells around that of the query

/// The nearest points found so far.
class Nearest {
 public:
  Nearest(std::size_t most, double radius, std::vector<Neighbour>& found)
      : most_(most), radius2_(radius * radius), found_(found) {
    found.clear();
  }

  /// Returns true when points at this squared distance or beyond cannot be among the nearest.
  bool excludes(double distance2) const {
    return distance2 >= radius2_ || (found_.size() == most_ && distance2 > found_.back().distance2);
  }

  void add(const Neighbour& candidate) {
    if (excludes(candidate.distance2)) return;
    const auto at = std::lower_bound(found_.begin(), found_.end(), candidate);
    // Two cells may share a bucket, whose points are then visited twice.
    if (at != found_.end() && at->index == candidate.index) return;
    found_.insert(at, candidate);
    if (found_.size() > most_) found_.pop_back();
  }

 private:
  std::size_t most_;
  double radius2_;
  std::vector<Neighbour>& found_;
};

}  // namespace

Eigen::AlignedBox3d bounds_of(const CloudView& cloud) {
  Eigen::AlignedBox3d box;
  for (std::size_t i = 0; i < cloud.count; ++i) box.extend(cloud.point(i));
  return box;
}

PointGrid::PointGrid(const CloudView& cloud, const Eigen::Vector3d& low, std::size_t stride, double cell,
                     unsigned threads)
    : cloud_(cloud), low_(low), cell_(cell), per_cell_(1.0 / cell) {
  const std::size_t count = (cloud.count + stride - 1) / stride;
  mask_ = 64;
  while (mask_ < count / 2) mask_ *= 2;
  mask_ -= 1;
  LargeVector<std::uint32_t> bucket(count);
  constexpr std::size_t kTask = 4096;
  parallel_for((count + kTask - 1) / kTask, threads, [&](std::size_t task, unsigned) {
    for (std::size_t k = task * kTask; k < std::min(count, (task + 1) * kTask); ++k)
      bucket[k] = static_cast<std::uint32_t>(bucket_of(cell_of(cloud_.point(k * stride))));
  });
  // Counting sort: the write position of each bucket moves from its begin to its end.
  begin_.resize(mask_ + 3);
  for (const std::uint32_t b : bucket) ++begin_[b + std::size_t{2}];
  for (std::size_t b = 2; b < begin_.size(); ++b) begin_[b] += begin_[b - 1];
  points_.resize(count);
  for (std::size_t k = 0; k < count; ++k)
    points_[begin_[bucket[k] + std::size_t{1}]++] = static_cast<std::uint32_t>(k * stride);
}

std::size_t PointGrid::bucket_of(const Cell& cell) const {
  // Blocks of 4 x 4 x 4 cells are contiguous in memory.
  const auto block = [](std::int64_t value) { return static_cast<std::uint64_t>(value >> 2) & 0x1FFFFF; };
  const auto within = [](std::int64_t value) { return static_cast<std::uint64_t>(value) & 3; };
  const std::uint64_t key = block(cell.x()) << 42 | block(cell.y()) << 21 | block(cell.z());
  return (scramble(key) << 6 | within(cell.x()) << 4 | within(cell.y()) << 2 | within(cell.z())) & mask_;
}

bool PointGrid::search(const Eigen::Vector3d& from, std::size_t most, double radius,
                       std::vector<Neighbour>& found) const {
  Nearest nearest(most, radius, found);
  const Cell centre = cell_of(from);
  const Eigen::Array3d inside = (from - low_).array() - centre.cast<double>() * cell_;
  // Squared distance from the query, along each axis, to the cells up to kRings before and behind.
  double gap2[3][2 * kRings + 1] = {};
  for (int axis = 0; axis < 3; ++axis) {
    for (int ring = 1; ring <= kRings; ++ring) {
      const double before = inside[axis] + (ring - 1) * cell_;
      const double behind = ring * cell_ - inside[axis];
      gap2[axis][kRings - ring] = before * before;
      gap2[axis][kRings + ring] = behind * behind;
    }
  }
  const auto visit = [&](int x, int y, int z) {
    if (nearest.excludes(gap2[0][kRings + x] + gap2[1][kRings + y] + gap2[2][kRings + z])) return;
    const std::size_t bucket = bucket_of(centre + Cell(x, y, z));
    for (std::size_t k = begin_[bucket]; k < begin_[bucket + 1]; ++k)
      nearest.add({(cloud_.point(points_[k]) - from).squaredNorm(), points_[k]});
  };
  const double wall = std::min(inside.minCoeff(), (cell_ - inside).minCoeff());
  for (int ring = 0; ring <= kRings; ++ring) {
    for (int x = -ring; x <= ring; ++x) {
      for (int y = -ring; y <= ring; ++y) {
        const bool side = std::abs(x) == ring || std::abs(y) == ring;
        for (int z = -ring; z <= ring; z += side || ring == 0 ? 1 : 2 * ring) visit(x, y, z);
      }
    }
    const double reach = wall + ring * cell_;
    if (nearest.excludes(reach * reach)) return true;
  }
  return false;
}

}  // namespace sensor_rt
