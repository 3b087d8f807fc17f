#include "sensor_rt/cloud/grid_normals.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/geometry/parallel.h"

namespace sensor_rt {
namespace {

constexpr std::size_t kReach = 6;        // columns to either side
constexpr double kGap = 4.0;             // median steps between points of one surface
constexpr double kMinSine = 0.2;         // of the angle between the two directions
constexpr std::size_t kBlock = 400;      // frames that share a median step
constexpr std::size_t kTaskFrames = 16;  // frames per task of a thread

/// Three coordinates of each point of a row, padded by kReach unused entries on either side.
struct Columns3 {
  std::vector<double> x;
  std::vector<double> y;
  std::vector<double> z;

  void assign_zero(std::size_t count) {
    for (std::vector<double>* values : {&x, &y, &z}) values->assign(count + 2 * kReach, 0.0);
  }
  Eigen::Vector3d at(std::size_t i) const { return {x[i + kReach], y[i + kReach], z[i + kReach]}; }
  void add(std::size_t i, const Eigen::Vector3d& v) {
    x[i + kReach] += v.x();
    y[i + kReach] += v.y();
    z[i + kReach] += v.z();
  }
};

/// Squared step lengths, m², below which points are connected: per camera and block of frames.
struct LongestStep {
  double along2 = 0.0;
  double across2 = 0.0;
};

/// The points of one camera and frame, one per column.
struct Row {
  std::size_t size = 0;
  std::vector<std::int64_t> column;
  std::vector<std::size_t> first;  ///< in ProfileRows::order() of each column's points; size + 1 values
  Columns3 point;
  LongestStep longest;
  Columns3 across;  ///< sum of the steps to neighbouring frames
  std::vector<double>
      joined;  ///< 1 where a short step connects to the next column, else 0; padded like point

  /// The last of several points in a column is used.
  void gather(const CloudView& cloud, const ProfileRows& rows, std::size_t camera, std::size_t frame) {
    const std::size_t begin = rows.begin(camera, frame);
    const std::size_t end = rows.end(camera, frame);
    column.clear();
    first.clear();
    for (std::size_t k = begin; k < end; ++k) {
      const std::int64_t its = cloud.column[rows.order()[k]];
      if (!column.empty() && column.back() == its) continue;
      column.push_back(its);
      first.push_back(k);
    }
    first.push_back(end);
    size = column.size();
    point.assign_zero(size);
    for (std::size_t i = 0; i < size; ++i) point.add(i, cloud.point(rows.order()[first[i + 1] - 1]));
  }
};

/// Calls visit(i, j) for the columns that both rows contain, with the indices i in `a` and j in `b`.
template <typename Visit>
void for_shared_columns(const Row& a, const Row& b, const Visit& visit) {
  std::size_t i = 0;
  std::size_t j = 0;
  while (i < a.size && j < b.size) {
    const std::int64_t left = a.column[i];
    const std::int64_t right = b.column[j];
    if (left == right) visit(i, j);
    i += left <= right ? 1 : 0;
    j += right <= left ? 1 : 0;
  }
}

/// Computes the limit from the squared lengths of all steps; reorders them.
double longest_step2(std::vector<double>& steps2) {
  if (steps2.empty()) return 0.0;
  const auto middle = steps2.begin() + static_cast<std::ptrdiff_t>(steps2.size() / 2);
  std::nth_element(steps2.begin(), middle, steps2.end());
  double median = std::sqrt(*middle);
  if (steps2.size() % 2 == 0) median = 0.5 * (median + std::sqrt(*std::max_element(steps2.begin(), middle)));
  const double longest = std::min(kGap * median, kMaxNeighbourDistance);
  return longest * longest;
}

LongestStep max_steps(const CloudView& cloud, const ProfileRows& rows, std::size_t camera,
                      std::size_t block) {
  std::vector<double> along2;
  std::vector<double> across2;
  Row row;
  Row next;
  // The steps at the border belong to both blocks.
  const std::size_t begin = block * kBlock - (block > 0 ? 1 : 0);
  const std::size_t end = std::min(cloud.frames, (block + 1) * kBlock + 1);
  row.gather(cloud, rows, camera, begin);
  for (std::size_t frame = begin; frame < end; ++frame) {
    for (std::size_t i = 0; i + 1 < row.size; ++i) {
      if (row.column[i + 1] == row.column[i] + 1)
        along2.push_back((row.point.at(i + 1) - row.point.at(i)).squaredNorm());
    }
    if (frame + 1 == end) break;
    next.gather(cloud, rows, camera, frame + 1);
    for_shared_columns(row, next, [&](std::size_t i, std::size_t j) {
      across2.push_back((next.point.at(j) - row.point.at(i)).squaredNorm());
    });
    std::swap(row, next);
  }
  return {longest_step2(along2), longest_step2(across2)};
}

/// Adds the short steps between two frames to the across directions of both.
void join_across(Row& row, Row& next) {
  for_shared_columns(row, next, [&](std::size_t i, std::size_t j) {
    const Eigen::Vector3d step = next.point.at(j) - row.point.at(i);
    const double length2 = step.squaredNorm();
    if (length2 < row.longest.across2) row.across.add(i, step);
    if (length2 < next.longest.across2) next.across.add(j, step);
  });
}

void join_along(Row& row) {
  row.joined.assign(row.size + 2 * kReach, 0.0);
  for (std::size_t i = 0; i + 1 < row.size; ++i) {
    const bool neighbours = row.column[i + 1] == row.column[i] + 1;
    const double length2 = (row.point.at(i + 1) - row.point.at(i)).squaredNorm();
    if (neighbours && length2 < row.longest.along2) row.joined[i + kReach] = 1.0;
  }
}

/// Adds to `sum`, per point, k times the difference to each k-th neighbour that is reached by a chain of
/// connected points.
SENSOR_RT_MULTIVERSION
void sum_along(std::size_t size, const double* __restrict joined, const double* __restrict values,
               double* __restrict chain, double* __restrict sum) {
  for (std::size_t i = 0; i < size; ++i) chain[i] = 1.0;
  for (std::size_t k = 1; k <= kReach; ++k) {
    const double weight = static_cast<double>(k);
    for (std::size_t i = 0; i < size; ++i) {
      chain[i] *= joined[i + k - 1];
      sum[i] += weight * chain[i] * (values[i + k] - values[i]);
    }
  }
  for (std::size_t i = 0; i < size; ++i) chain[i] = 1.0;
  for (std::size_t k = 1; k <= kReach; ++k) {
    const double weight = static_cast<double>(k);
    for (std::size_t i = 0; i < size; ++i) {
      chain[i] *= *(joined + i - k);
      sum[i] += weight * chain[i] * (values[i] - *(values + i - k));
    }
  }
}

class GridNormals {
 public:
  GridNormals(const CloudView& cloud, const ProfileRows& rows, double* normals)
      : cloud_(cloud), rows_(rows), normals_(normals) {}

  /// Processes the frames [begin, end).
  void run(std::size_t camera, std::size_t begin, std::size_t end, const std::vector<LongestStep>& blocks) {
    load(camera, begin, blocks, row_);
    if (begin > 0) {
      load(camera, begin - 1, blocks, next_);
      join_across(next_, row_);
    }
    for (std::size_t frame = begin; frame < end; ++frame) {
      load(camera, frame + 1, blocks, next_);
      join_across(row_, next_);
      join_along(row_);
      sum_along();
      for (std::size_t i = 0; i < row_.size; ++i) finish(i);
      std::swap(row_, next_);
    }
  }

  std::vector<UnresolvedPoint> unresolved;

 private:
  void load(std::size_t camera, std::size_t frame, const std::vector<LongestStep>& blocks, Row& row) {
    row.size = 0;
    if (frame < cloud_.frames) {
      row.gather(cloud_, rows_, camera, frame);
      row.longest = blocks[frame / kBlock];
    }
    row.across.assign_zero(row.size);
  }

  void sum_along() {
    along_.assign_zero(row_.size);
    chain_.resize(row_.size);
    const double* joined = row_.joined.data() + kReach;
    const auto sum = [&](const std::vector<double>& values, std::vector<double>& total) {
      sensor_rt::sum_along(row_.size, joined, values.data() + kReach, chain_.data(), total.data() + kReach);
    };
    sum(row_.point.x, along_.x);
    sum(row_.point.y, along_.y);
    sum(row_.point.z, along_.z);
  }

  /// Writes the normals of the points in the i-th column.
  void finish(std::size_t i) {
    const Eigen::Vector3d along = along_.at(i);
    const Eigen::Vector3d across = row_.across.at(i);
    const Eigen::Vector3d normal = along.cross(across);
    const double length2 = normal.squaredNorm();
    const bool spans = length2 > kMinSine * kMinSine * along.squaredNorm() * across.squaredNorm();
    const double scale = 1.0 / std::sqrt(length2);
    for (std::size_t k = row_.first[i]; k < row_.first[i + 1]; ++k) {
      const std::uint32_t index = rows_.order()[k];
      const Eigen::Vector3d light = cloud_.to_light(index);
      const double product = normal.dot(light);
      if (spans && product * product > kMinCosine * kMinCosine * length2 * light.squaredNorm()) {
        Eigen::Map<Eigen::Vector3d>(normals_ + 3 * std::size_t{index}) =
            std::copysign(scale, product) * normal;
      } else {
        const bool known = row_.joined[i + kReach] + row_.joined[i + kReach - 1] > 0.0;
        unresolved.push_back({index, known ? along : Eigen::Vector3d::Constant(std::nan(""))});
      }
    }
  }

  const CloudView& cloud_;
  const ProfileRows& rows_;
  double* normals_;
  Row row_;
  Row next_;
  Columns3 along_;
  std::vector<double> chain_;
};

}  // namespace

std::vector<UnresolvedPoint> grid_normals(const CloudView& cloud, const ProfileRows& rows, unsigned threads,
                                          double* normals) {
  const std::size_t blocks = (cloud.frames + kBlock - 1) / kBlock;
  std::vector<std::vector<LongestStep>> longest(rows.cameras(), std::vector<LongestStep>(blocks));
  parallel_for(rows.cameras() * blocks, threads, [&](std::size_t task, unsigned) {
    longest[task / blocks][task % blocks] = max_steps(cloud, rows, task / blocks, task % blocks);
  });

  const std::size_t stretches = (cloud.frames + kTaskFrames - 1) / kTaskFrames;
  const std::size_t tasks = rows.cameras() * stretches;
  std::vector<GridNormals> workers(thread_count(threads, tasks), GridNormals(cloud, rows, normals));
  parallel_for(tasks, threads, [&](std::size_t task, unsigned worker) {
    const std::size_t begin = task % stretches * kTaskFrames;
    workers[worker].run(task / stretches, begin, std::min(cloud.frames, begin + kTaskFrames),
                        longest[task / stretches]);
  });
  std::vector<UnresolvedPoint> unresolved;
  for (const GridNormals& worker : workers)
    unresolved.insert(unresolved.end(), worker.unresolved.begin(), worker.unresolved.end());
  std::sort(unresolved.begin(), unresolved.end(),
            [](const UnresolvedPoint& a, const UnresolvedPoint& b) { return a.index < b.index; });
  return unresolved;
}

}  // namespace sensor_rt
