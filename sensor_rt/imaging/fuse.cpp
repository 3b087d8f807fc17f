#include "sensor_rt/imaging/fuse.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace sensor_rt {
namespace {

constexpr double kNoiseSigmas = 4.0;
constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();

double square(double x) { return x * x; }

/// Where the line of sight of a column meets the stripe that another camera saw.
struct Meeting {
  double distance = 0.0;  ///< along the line, m
  double variance = 0.0;  ///< m²
};

class PointFusion {
 public:
  PointFusion(const std::vector<Camera>& cameras, double tolerance_px, std::size_t begin, Profiles& profiles)
      : cameras_(cameras), tolerance_px_(tolerance_px), begin_(begin), profiles_(profiles) {
    for (const Camera& camera : cameras) {
      camera_from_sensor_.push_back(camera.sensor_from_camera.inverse());
      at_column_.emplace_back(static_cast<std::size_t>(camera.width_px) + 1, kNone);
    }
    for (std::size_t i = begin; i < profiles.size(); ++i) {
      at_column_[camera_of(i)][static_cast<std::size_t>(profiles.column[i])] = i;
    }
    absorbed_.assign(profiles.size(), false);
  }

  void run() {
    for (std::size_t i = begin_; i < profiles_.size(); ++i) {
      for (std::size_t b = camera_of(i) + 1; b < cameras_.size() && !absorbed_[i]; ++b) absorb(i, b);
    }
    drop_absorbed();
  }

 private:
  std::size_t camera_of(std::size_t i) const { return static_cast<std::size_t>(profiles_.camera[i]); }

  void absorb(std::size_t i, std::size_t b) {
    const Eigen::Vector3d point = profiles_.points_in_sensor[i];
    const double column = cameras_[b].project(camera_from_sensor_[b] * point).x();
    if (!(column >= 0.0 && column < cameras_[b].width_px - 1.0)) return;
    const std::size_t left = at_column_[b][static_cast<std::size_t>(column)];
    const std::size_t right = at_column_[b][static_cast<std::size_t>(column) + 1];
    if (left == kNone || right == kNone) return;
    const Eigen::Vector3d per_row =
        triangulation_jacobian(cameras_[camera_of(i)], {profiles_.column[i], profiles_.row[i]}).col(1);
    const Eigen::Vector3d along = per_row.normalized();
    const double own = square(along.dot(profiles_.deviation[i]));
    Meeting met;
    if (!meet(point, along, left, right, met)) return;
    const double allowed = tolerance_px_ * per_row.norm() + kNoiseSigmas * std::sqrt(own + met.variance);
    if (std::fabs(met.distance) > allowed) return;
    const double sum = own + met.variance;
    const double share = sum > 0.0 ? own / sum : 0.5;
    const double variance = own * (1.0 - share);
    profiles_.points_in_sensor[i] = point + share * met.distance * along;
    profiles_.deviation[i] = std::sqrt(variance) * along;
    profiles_.sigma[i] = static_cast<float>(std::sqrt(variance));
    absorbed_[left] = absorbed_[right] = true;
  }

  /// False where the line runs beside or along the stretch between the two points.
  bool meet(const Eigen::Vector3d& point, const Eigen::Vector3d& along, std::size_t left, std::size_t right,
            Meeting& met) const {
    const Eigen::Vector3d& l = profiles_.points_in_sensor[left];
    const Eigen::Vector3d& r = profiles_.points_in_sensor[right];
    const Eigen::Vector3d stretch = r - l;
    const Eigen::Vector3d normal(0.0, -stretch.z(), stretch.y());
    const double slope = normal.dot(along);
    if (std::fabs(slope) < 1e-3 * normal.norm()) return false;
    met.distance = normal.dot(l - point) / slope;
    const double share = (point + met.distance * along - l).dot(stretch) / stretch.squaredNorm();
    if (!(share > -0.5 && share < 1.5)) return false;
    const auto variance = [&](std::size_t k) { return square(normal.dot(profiles_.deviation[k]) / slope); };
    met.variance = (1.0 - share) * (1.0 - share) * variance(left) + share * share * variance(right);
    return true;
  }

  void drop_absorbed() {
    std::size_t kept = begin_;
    for (std::size_t i = begin_; i < profiles_.size(); ++i) {
      if (absorbed_[i]) continue;
      if (kept != i) profiles_.move(i, kept);
      ++kept;
    }
    profiles_.resize(kept);
  }

  const std::vector<Camera>& cameras_;
  double tolerance_px_;
  std::size_t begin_;
  Profiles& profiles_;
  std::vector<Rigid3> camera_from_sensor_;
  std::vector<std::vector<std::size_t>> at_column_;
  std::vector<bool> absorbed_;
};

}  // namespace

void fuse(const std::vector<Camera>& cameras, double tolerance_px, std::size_t begin, Profiles& profiles) {
  PointFusion(cameras, tolerance_px, begin, profiles).run();
}

}  // namespace sensor_rt
