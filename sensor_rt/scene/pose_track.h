// Poses of all shapes during an exposure, relative to the sensor.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/scene/scene.h"

namespace sensor_rt {

/// Poses of a batch of exposures: `samples` per exposure, evenly spaced from its start to its end (1: no
/// motion). Sample s of exposure e is at [e * samples + s]; body b at [(e * bodies + b) * samples + s].
struct Exposures {
  std::size_t count = 0;
  std::size_t samples = 0;
  std::size_t bodies = 0;
  std::vector<Rigid3> world_from_sensor;
  std::vector<Rigid3> world_from_body;
  std::vector<double> duration;     ///< s; with a rolling shutter the exposure time of each row
  std::vector<std::int64_t> index;  ///< frame number, part of the key of the noise

  const Rigid3* sensor_poses(std::size_t exposure) const { return &world_from_sensor[exposure * samples]; }
  const Rigid3* body_poses(std::size_t exposure, std::size_t body) const {
    return &world_from_body[(exposure * bodies + body) * samples];
  }
  /// Returns true when there is no relative motion during an exposure.
  bool is_still(std::size_t exposure) const;
};

/// Displacement of the points of a shape during an interval, as a linear function of their positions.
struct Displacement {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Zero();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  /// `shape_from_reference`: at the instant of the points; then those at the start and the end of the
  /// interval.
  static Displacement between(const Rigid3& shape_from_reference, const Rigid3& at_start,
                              const Rigid3& at_end) {
    const Rigid3 before = at_start.inverse() * shape_from_reference;
    const Rigid3 after = at_end.inverse() * shape_from_reference;
    return {after.rotation - before.rotation, after.translation - before.translation};
  }
  Eigen::Vector3d of(const Eigen::Vector3d& point) const { return rotation * point + translation; }
};

/// Poses of all shapes at several instants of one exposure, in a reference frame that moves with the sensor.
/// Coordinates near the sensor are small, which preserves single precision, and the sensor's own rays are the
/// same in every exposure.
class PoseTrack {
 public:
  /// Computes the poses at `fractions` of the exposure, in [0, 1], or extrapolated beyond.
  void set(const Scene& scene, const Exposures& exposures, std::size_t exposure,
           const std::vector<double>& fractions, const Rigid3& sensor_from_reference);

  /// Sets a single instant with body poses given in the frame of the rays.
  void set_still(const Scene& scene, const Rigid3* reference_from_body);

  std::size_t instants() const { return instants_; }
  const Rigid3& reference_from_light(std::size_t light, std::size_t instant) const {
    return reference_from_light_[light * instants_ + instant];
  }
  const Rigid3& shape_from_reference(std::size_t shape, std::size_t instant) const {
    return shape_from_reference_[shape * instants_ + instant];
  }

 private:
  void set_lights(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                  const std::vector<double>& fractions);

  std::size_t instants_ = 0;
  std::vector<Rigid3> shape_from_reference_;
  std::vector<Rigid3> reference_from_light_;
  std::vector<Rigid3> reference_from_world_;
};

/// Returns the frame number for the noise key; background frames (laser off) have numbers of their own.
inline std::int64_t frame_number(const Exposures& exposures, std::size_t exposure, bool laser_on) {
  const std::int64_t index = exposures.index[exposure];
  return laser_on ? index : -1 - index;
}

/// Returns the pose at a fraction of the exposure, from evenly spaced samples; extrapolates beyond the end at
/// constant velocity.
Rigid3 pose_at(const Rigid3* poses, std::size_t samples, double fraction);

}  // namespace sensor_rt
