#include "sensor_rt/cloud/profile_rows.h"

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <string>

#include "sensor_rt/geometry/parallel.h"

namespace sensor_rt {
namespace {

void validate(const CloudView& cloud) {
  if (cloud.count > std::numeric_limits<std::uint32_t>::max())
    throw std::invalid_argument("points: at most 2^32 - 1, got " + std::to_string(cloud.count));
  for (std::size_t i = 0; i < cloud.count; ++i) {
    if (!(cloud.point(i).cwiseAbs().maxCoeff<Eigen::PropagateNaN>() <= 1e6))
      throw std::invalid_argument("point " + std::to_string(i) + " is not finite or beyond 1000 km");
    if (cloud.frame[i] < 0 || static_cast<std::size_t>(cloud.frame[i]) >= cloud.frames) {
      throw std::invalid_argument("point " + std::to_string(i) + ": frame " + std::to_string(cloud.frame[i]) +
                                  " of " + std::to_string(cloud.frames));
    }
  }
}

/// Returns the distinct cameras, ascending.
std::vector<std::int32_t> distinct_cameras(const CloudView& cloud) {
  std::vector<std::int32_t> known;
  for (std::size_t i = 0; i < cloud.count; ++i) {
    if (i > 0 && cloud.camera[i] == cloud.camera[i - 1]) continue;
    const auto at = std::lower_bound(known.begin(), known.end(), cloud.camera[i]);
    if (at == known.end() || *at != cloud.camera[i]) known.insert(at, cloud.camera[i]);
  }
  return known;
}

}  // namespace

ProfileRows::ProfileRows(const CloudView& cloud, unsigned threads) : frames_(cloud.frames) {
  validate(cloud);
  const std::vector<std::int32_t> cameras = distinct_cameras(cloud);
  cameras_ = cameras.size();
  const std::size_t rows = cameras_ * frames_;
  const auto row_of = [&](std::size_t i) {
    const auto at = std::lower_bound(cameras.begin(), cameras.end(), cloud.camera[i]);
    return static_cast<std::size_t>(at - cameras.begin()) * frames_ +
           static_cast<std::size_t>(cloud.frame[i]);
  };
  // Counting sort: the write position of each row moves from its begin to its end.
  begin_.assign(rows + 2, 0);
  for (std::size_t i = 0; i < cloud.count; ++i) ++begin_[row_of(i) + 2];
  for (std::size_t row = 2; row < begin_.size(); ++row) begin_[row] += begin_[row - 1];
  order_.resize(cloud.count);
  for (std::size_t i = 0; i < cloud.count; ++i)
    order_[begin_[row_of(i) + 1]++] = static_cast<std::uint32_t>(i);
  begin_.pop_back();

  const auto before = [&](std::uint32_t a, std::uint32_t b) {
    return cloud.column[a] != cloud.column[b] ? cloud.column[a] < cloud.column[b] : a < b;
  };
  constexpr std::size_t kRows = 16;
  parallel_for((rows + kRows - 1) / kRows, threads, [&](std::size_t task, unsigned) {
    for (std::size_t row = task * kRows; row < std::min(rows, (task + 1) * kRows); ++row) {
      const auto first = order_.begin() + static_cast<std::ptrdiff_t>(begin_[row]);
      const auto last = order_.begin() + static_cast<std::ptrdiff_t>(begin_[row + 1]);
      if (first == last) continue;
      // Mirrored cameras have descending columns.
      if (before(*(last - 1), *first)) std::reverse(first, last);
      if (!std::is_sorted(first, last, before)) std::sort(first, last, before);
    }
  });
}

}  // namespace sensor_rt
