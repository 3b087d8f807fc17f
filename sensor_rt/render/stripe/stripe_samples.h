// Instants, source points and lens points that an image of the stripe averages over.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/render/render_plan.h"
#include "sensor_rt/render/row_timing.h"
#include "sensor_rt/scene/pose_track.h"
#include "sensor_rt/tracing/ray_view.h"

namespace sensor_rt {

/// Samples of one exposure. Each has an instant, a point of the laser source and a point of every lens; the
/// image is the mean of the images of all samples.
///
/// With a point source and pinholes, each sample is the midpoint of a time interval with at most a pixel of
/// motion; without motion a single sample is exact. A line source and a sampled lens use the lattice of
/// SamplingPattern. With a rolling shutter the samples are evenly spaced over the time of all rows, and each
/// row interpolates between them.
class StripeSamples {
 public:
  /// Finds the samples and their poses.
  void set(const RenderPlan& plan, const Scene& scene, const Exposures& exposures, std::size_t exposure);

  /// Returns the poses, an instant for each sample.
  const PoseTrack& track() const { return track_; }

  /// Returns the displacement of a point of a shape (reference frame) during the time interval of a sample;
  /// zero where samples are instants.
  Eigen::Vector3d travel(std::int32_t shape, std::size_t sample, const Eigen::Vector3d& point) const {
    if (motion_.empty()) return Eigen::Vector3d::Zero();
    return motion_[static_cast<std::size_t>(shape) * size() + sample].of(point);
  }

  std::size_t size() const { return fractions_.size(); }

  /// Returns the index into the lattice of source and lens points.
  std::size_t lattice_point(std::size_t sample) const { return sample % lattice_; }

  /// Computes the share of a sample in every row of a camera's image.
  void row_shares(const Camera& camera, std::size_t sample, std::vector<float>& shares) const;

 private:
  void set_rows(double motion_px);
  void set_lattice(const RenderPlan& plan, double motion_px);
  void find_motion(const Scene& scene);

  std::vector<double> fractions_;  ///< of the duration of the poses
  std::size_t lattice_ = 1;        ///< number of points of source and lens
  RowTiming timing_;  ///< of a rolling shutter in motion; else all rows are exposed simultaneously
  PoseTrack track_;
  PoseTrack ends_;                    ///< of the time intervals
  std::vector<Displacement> motion_;  ///< [shape][sample]; empty: none
  RayView laser_;                     ///< for the shapes that the laser can reach
};

}  // namespace sensor_rt
