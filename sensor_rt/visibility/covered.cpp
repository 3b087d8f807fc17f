#include "sensor_rt/visibility/covered.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace sensor_rt {
namespace {

using Point = Eigen::Map<const Eigen::Vector3d>;

/// Voxel grid; each voxel lists the samples whose tolerance spheres intersect it.
class SampleVoxels {
 public:
  SampleVoxels(const OrientedPoints& samples, double tolerance) : tolerance_(tolerance) {
    Eigen::Vector3d high = Point(samples.points);
    low_ = high;
    for (std::size_t i = 0; i < samples.count; ++i) {
      const Point p(samples.points + 3 * i);
      if (!p.allFinite()) throw std::invalid_argument("sample " + std::to_string(i) + " is not finite");
      low_ = low_.cwiseMin(p);
      high = high.cwiseMax(p);
    }
    low_.array() -= tolerance;
    high.array() += tolerance;
    side_ = std::max(tolerance, (high - low_).maxCoeff() / kMaxPerAxis);
    for (int k = 0; k < 3; ++k) size_[k] = static_cast<int>((high[k] - low_[k]) / side_) + 1;
    begin_.assign(static_cast<std::size_t>(size_[0]) * size_[1] * size_[2] + 1, 0);
    for_all(samples, [&](std::size_t voxel, std::uint32_t) { ++begin_[voxel + 1]; });
    for (std::size_t v = 1; v < begin_.size(); ++v) begin_[v] += begin_[v - 1];
    end_.assign(begin_.begin(), begin_.end() - 1);
    list_.resize(begin_.back());
    for_all(samples, [&](std::size_t voxel, std::uint32_t sample) { list_[end_[voxel]++] = sample; });
  }

  /// Returns the voxel that contains a point, or the number of voxels if there is none.
  std::size_t voxel(const double* p) const {
    const double x = (p[0] - low_[0]) / side_;
    const double y = (p[1] - low_[1]) / side_;
    const double z = (p[2] - low_[2]) / side_;
    // The comparison is false for NaN.
    const bool inside = x >= 0.0 && y >= 0.0 && z >= 0.0 && x < size_[0] && y < size_[1] && z < size_[2];
    return inside ? index(static_cast<int>(x), static_cast<int>(y), static_cast<int>(z)) : end_.size();
  }
  std::size_t count() const { return end_.size(); }

  /// Calls done(sample) for the samples of a voxel and removes those for which it returns true.
  template <typename Done>
  void drop(std::size_t voxel, const Done& done) {
    std::uint32_t& end = end_[voxel];
    for (std::uint32_t i = begin_[voxel]; i < end;) {
      if (done(list_[i])) {
        list_[i] = list_[--end];
      } else {
        ++i;
      }
    }
  }

 private:
  static constexpr double kMaxPerAxis = 160.0;

  std::size_t index(int x, int y, int z) const {
    return (static_cast<std::size_t>(x) * size_[1] + static_cast<std::size_t>(y)) * size_[2] +
           static_cast<std::size_t>(z);
  }

  template <typename Body>
  void for_all(const OrientedPoints& samples, const Body& body) const {
    for (std::size_t i = 0; i < samples.count; ++i) {
      int first[3];
      int last[3];
      for (int k = 0; k < 3; ++k) {
        const double at = samples.points[3 * i + static_cast<std::size_t>(k)] - low_[k];
        first[k] = std::max(0, static_cast<int>((at - tolerance_) / side_));
        last[k] = std::min(size_[k] - 1, static_cast<int>((at + tolerance_) / side_));
      }
      for (int x = first[0]; x <= last[0]; ++x) {
        for (int y = first[1]; y <= last[1]; ++y) {
          for (int z = first[2]; z <= last[2]; ++z) body(index(x, y, z), static_cast<std::uint32_t>(i));
        }
      }
    }
  }

  double tolerance_;
  double side_ = 0.0;
  Eigen::Vector3d low_;
  int size_[3];
  std::vector<std::uint32_t> begin_;  ///< first entry of each voxel in the list
  std::vector<std::uint32_t> end_;
  std::vector<std::uint32_t> list_;  ///< samples
};

}  // namespace

std::vector<std::uint8_t> covered_samples(const OrientedPoints& samples, const OrientedPoints& cloud,
                                          double tolerance, double min_cosine) {
  if (!(tolerance > 0.0) || !std::isfinite(tolerance))
    throw std::invalid_argument("tolerance: expected a positive number");
  std::vector<std::uint8_t> covered(samples.count, 0);
  if (samples.count == 0) return covered;
  SampleVoxels voxels(samples, tolerance);
  for (std::size_t i = 0; i < cloud.count; ++i) {
    const double* point = cloud.points + 3 * i;
    const std::size_t voxel = voxels.voxel(point);
    if (voxel == voxels.count()) continue;
    voxels.drop(voxel, [&](std::uint32_t sample) {
      if (covered[sample] != 0) return true;
      if ((Point(samples.points + 3 * sample) - Point(point)).squaredNorm() > tolerance * tolerance)
        return false;
      // A comparison with NaN is false: points without a normal match.
      if (cloud.normals != nullptr &&
          Point(samples.normals + 3 * sample).dot(Point(cloud.normals + 3 * i)) < min_cosine)
        return false;
      covered[sample] = 1;
      return true;
    });
  }
  return covered;
}

}  // namespace sensor_rt
