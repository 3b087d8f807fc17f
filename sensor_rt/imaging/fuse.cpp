#include "sensor_rt/imaging/fuse.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {
namespace {

constexpr double kNoiseSigmas = 4.0;

double square(double x) { return x * x; }

/// Intersection of the line of sight of a column with the stripe of another camera.
struct Crossing {
  double distance = 0.0;  ///< along the line, m
  double variance = 0.0;  ///< m²
};

class PointFusion {
 public:
  PointFusion(const std::vector<Camera>& cameras, const SheetSurface& sheet, double tolerance_px,
              std::size_t begin, Profiles& profiles, const Sampling* sampling)
      : cameras_(cameras),
        sheet_(sheet),
        tolerance_px_(tolerance_px),
        begin_(begin),
        profiles_(profiles),
        sampling_(sampling),
        first_(cameras.size() + 1, profiles.size()) {
    for (std::size_t k = 0; k < cameras.size(); ++k) {
      camera_from_sensor_.push_back(cameras[k].sensor_from_camera.inverse());
      const auto at = std::lower_bound(profiles.camera.begin() + static_cast<std::ptrdiff_t>(begin),
                                       profiles.camera.end(), static_cast<std::int32_t>(k));
      first_[k] = static_cast<std::size_t>(at - profiles.camera.begin());
    }
    merged_.assign(profiles.size(), false);
  }

  void run() {
    for (std::size_t i = begin_; i < profiles_.size(); ++i) {
      for (std::size_t b = camera_of(i) + 1; b < cameras_.size() && !merged_[i]; ++b) merge(i, b);
    }
    remove_merged();
  }

 private:
  double column(std::size_t i) const {
    return sampling_ == nullptr ? profiles_.column[i] : sampling_->column[i - begin_];
  }
  bool adjacent(std::size_t left, std::size_t right) const {
    const auto number = [this](std::size_t i) {
      return sampling_ == nullptr ? profiles_.column[i] : sampling_->number[i - begin_];
    };
    return std::abs(number(right) - number(left)) == 1;
  }
  std::size_t camera_of(std::size_t i) const { return static_cast<std::size_t>(profiles_.camera[i]); }

  void merge(std::size_t i, std::size_t b) {
    const Eigen::Vector3d point = profiles_.points_in_sensor[i];
    const double seen = cameras_[b].project(camera_from_sensor_[b] * point).x();
    std::size_t right = first_[b];
    for (std::size_t count = first_[b + 1] - right; count > 0;) {
      const std::size_t half = count / 2;
      const bool before = column(right + half) <= seen;
      right = before ? right + half + 1 : right;
      count = before ? count - half - 1 : half;
    }
    if (right == first_[b] || right == first_[b + 1]) return;
    const std::size_t left = right - 1;
    if (!adjacent(left, right)) return;
    const Eigen::Vector3d per_row =
        triangulation_jacobian(cameras_[camera_of(i)], sheet_, {column(i), profiles_.row[i]}, point).col(1);
    const Eigen::Vector3d along = per_row.normalized();
    const double own = square(along.dot(profiles_.deviation[i].cast<double>()));
    Crossing crossing;
    if (!intersect(point, along, left, right, crossing)) return;
    const double allowed = tolerance_px_ * per_row.norm() + kNoiseSigmas * std::sqrt(own + crossing.variance);
    if (std::fabs(crossing.distance) > allowed) return;
    const double sum = own + crossing.variance;
    const double share = sum > 0.0 ? own / sum : 0.5;
    const double variance = own * (1.0 - share);
    profiles_.points_in_sensor[i] = point + share * crossing.distance * along;
    profiles_.deviation[i] = (std::sqrt(variance) * along).cast<float>();
    profiles_.sigma[i] = static_cast<float>(std::sqrt(variance));
    merged_[left] = merged_[right] = true;
  }

  /// Returns false when the line misses the segment between the two points or is parallel to it.
  bool intersect(const Eigen::Vector3d& point, const Eigen::Vector3d& along, std::size_t left,
                 std::size_t right, Crossing& crossing) const {
    const Eigen::Vector3d& l = profiles_.points_in_sensor[left];
    const Eigen::Vector3d& r = profiles_.points_in_sensor[right];
    const Eigen::Vector3d stretch = r - l;
    const Eigen::Vector3d normal(0.0, -stretch.z(), stretch.y());
    const double slope = normal.dot(along);
    if (std::fabs(slope) < 1e-3 * normal.norm()) return false;
    crossing.distance = normal.dot(l - point) / slope;
    const double share = (point + crossing.distance * along - l).dot(stretch) / stretch.squaredNorm();
    if (!(share > -0.5 && share < 1.5)) return false;
    const auto variance = [&](std::size_t k) {
      return square(normal.dot(profiles_.deviation[k].cast<double>()) / slope);
    };
    crossing.variance = (1.0 - share) * (1.0 - share) * variance(left) + share * share * variance(right);
    return true;
  }

  void remove_merged() {
    std::size_t kept = begin_;
    for (std::size_t i = begin_; i < profiles_.size(); ++i) {
      if (merged_[i]) continue;
      if (kept != i) profiles_.move(i, kept);
      ++kept;
    }
    profiles_.resize(kept);
  }

  const std::vector<Camera>& cameras_;
  const SheetSurface& sheet_;
  double tolerance_px_;
  std::size_t begin_;
  Profiles& profiles_;
  const Sampling* sampling_;
  std::vector<std::size_t> first_;  ///< first point of each camera, and the end
  std::vector<Rigid3> camera_from_sensor_;
  std::vector<bool> merged_;
};

}  // namespace

void fuse(const std::vector<Camera>& cameras, const SheetSurface& sheet, double tolerance_px,
          std::size_t begin, Profiles& profiles, const Sampling* sampling) {
  PointFusion(cameras, sheet, tolerance_px, begin, profiles, sampling).run();
}

}  // namespace sensor_rt
