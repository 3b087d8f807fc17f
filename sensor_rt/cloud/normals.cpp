#include "sensor_rt/cloud/normals.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "sensor_rt/cloud/grid_normals.h"
#include "sensor_rt/cloud/point_grid.h"
#include "sensor_rt/cloud/profile_rows.h"
#include "sensor_rt/geometry/parallel.h"

namespace sensor_rt {
namespace {

constexpr std::size_t kNeighbours = 12;
constexpr double kMinSpread =
    1e-2;  // ratio of the smaller to the larger variance in the plane: below it the points are collinear

/// Writes the normal, oriented towards the light, unless the plane is parallel to the light.
bool set_normal(const CloudView& cloud, std::uint32_t index, const Eigen::Vector3d& normal, double* normals) {
  const double cosine = normal.dot(cloud.to_light(index).normalized());
  if (!(std::abs(cosine) > kMinCosine)) return false;
  Eigen::Map<Eigen::Vector3d>(normals + 3 * std::size_t{index}) = cosine < 0.0 ? -normal : normal;
  return true;
}

/// Computes the normal of the best-fit plane, with arbitrary sign. Returns false for collinear points.
bool fit_plane(const CloudView& cloud, const std::vector<Neighbour>& points, Eigen::Vector3d& normal) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& point : points) mean += cloud.point(point.index) / static_cast<double>(points.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const auto& point : points) {
    const Eigen::Vector3d offset = cloud.point(point.index) - mean;
    scatter += offset * offset.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(scatter);
  normal = solver.eigenvectors().col(0);
  return solver.eigenvalues()[1] > kMinSpread * solver.eigenvalues()[2];
}

/// Returns the edge of cells that contain a few of `count` points each, if these lie on a surface that fills
/// the box.
double cell_size(const Eigen::AlignedBox3d& box, std::size_t count) {
  constexpr double kPointsPerCell = 6.0;
  const Eigen::Vector3d size = box.sizes();
  const double area = 2.0 * (size.x() * size.y() + size.y() * size.z() + size.z() * size.x());
  const double least = std::max(size.maxCoeff() * 0x1p-20, 1e-6);
  return std::max(std::sqrt(kPointsPerCell * area / static_cast<double>(count)), least);
}

/// Computes normals of planes through the nearest neighbours, for points without a normal.
///
/// The point spacing within a profile is much smaller than that between profiles, so that all nearest
/// neighbours may lie in one profile; then every 4th, 16th, … point is used.
class PlaneNormals {
 public:
  PlaneNormals(const CloudView& cloud, unsigned threads, double* normals)
      : cloud_(cloud), box_(bounds_of(cloud)), threads_(threads), normals_(normals) {}

  /// Removes the points that now have a normal.
  void run(std::vector<UnresolvedPoint>& unresolved) const {
    for (const std::size_t stride : {1, 4, 16, 64}) {
      const std::size_t count = (cloud_.count + stride - 1) / stride;
      if (count < 3 || unresolved.empty()) return;
      std::vector<Outcome> outcome(unresolved.size(), Outcome::kUncertain);
      // Sparse points need larger cells.
      for (double cell = cell_size(box_, count); pending(outcome); cell *= 4.0)
        search(PointGrid(cloud_, box_.min(), stride, cell, threads_), count, unresolved, outcome);
      std::size_t kept = 0;
      for (std::size_t k = 0; k < unresolved.size(); ++k)
        if (outcome[k] == Outcome::kNoPlane) unresolved[kept++] = unresolved[k];
      unresolved.resize(kept);
    }
  }

 private:
  enum class Outcome : char { kUncertain, kNoPlane, kPlane };

  static bool pending(const std::vector<Outcome>& outcome) {
    return std::find(outcome.begin(), outcome.end(), Outcome::kUncertain) != outcome.end();
  }

  void search(const PointGrid& grid, std::size_t count, const std::vector<UnresolvedPoint>& unresolved,
              std::vector<Outcome>& outcome) const {
    const std::size_t wanted = std::min(kNeighbours, count);
    constexpr std::size_t kTask = 64;
    parallel_for((unresolved.size() + kTask - 1) / kTask, threads_, [&](std::size_t task, unsigned) {
      std::vector<Neighbour> found;
      for (std::size_t k = task * kTask; k < std::min(unresolved.size(), (task + 1) * kTask); ++k) {
        const std::uint32_t index = unresolved[k].index;
        if (outcome[k] != Outcome::kUncertain) continue;
        if (!grid.search(cloud_.point(index), wanted, kMaxNeighbourDistance, found)) continue;
        Eigen::Vector3d normal;
        const bool plane = found.size() == wanted && fit_plane(cloud_, found, normal) &&
                           set_normal(cloud_, index, normal, normals_);
        outcome[k] = plane ? Outcome::kPlane : Outcome::kNoPlane;
      }
    });
  }

  const CloudView& cloud_;
  Eigen::AlignedBox3d box_;
  unsigned threads_;
  double* normals_;
};

/// Returns the perpendicular to `along` that is closest to the light; NaN when there is none.
Eigen::Vector3d perpendicular(const Eigen::Vector3d& along, const Eigen::Vector3d& to_light) {
  const Eigen::Vector3d normal = to_light - along.dot(to_light) / along.squaredNorm() * along;
  const double length = normal.norm();
  if (!(length > kMinCosine)) return Eigen::Vector3d::Constant(std::nan(""));
  return normal / length;
}

}  // namespace

LargeVector<double> estimate_normals(const CloudView& cloud, unsigned threads) {
  LargeVector<double> normals(3 * cloud.count);
  std::vector<UnresolvedPoint> unresolved =
      grid_normals(cloud, ProfileRows(cloud, threads), threads, normals.data());
  PlaneNormals(cloud, threads, normals.data()).run(unresolved);
  for (const UnresolvedPoint& point : unresolved) {
    const Eigen::Vector3d normal = perpendicular(point.along, cloud.to_light(point.index).normalized());
    Eigen::Map<Eigen::Vector3d>(normals.data() + 3 * std::size_t{point.index}) = normal;
  }
  return normals;
}

}  // namespace sensor_rt
