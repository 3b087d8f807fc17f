// Where everything is during an exposure, seen from the sensor.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/scene/scene.h"

namespace sensor_rt {

/// Poses over a batch of exposures: `samples` per exposure, evenly spaced from its start to its end (one:
/// still). Sample s of exposure e stands at [e * samples + s]; body b at [(e * bodies + b) * samples + s].
struct Exposures {
  std::size_t count = 0;
  std::size_t samples = 0;
  std::size_t bodies = 0;
  std::vector<Rigid3> world_from_sensor;
  std::vector<Rigid3> world_from_body;
  std::vector<double> duration;     ///< s; with a rolling shutter that of each row, not of all poses
  std::vector<std::int64_t> index;  ///< frame number: keys the noise

  const Rigid3* sensor_poses(std::size_t exposure) const { return &world_from_sensor[exposure * samples]; }
  const Rigid3* body_poses(std::size_t exposure, std::size_t body) const {
    return &world_from_body[(exposure * bodies + body) * samples];
  }
};

/// Poses of all shapes at a few instants of one exposure, in a reference frame that moves with the sensor.
/// Near the sensor numbers are small, so that single precision goes far; the sensor's own rays are the same
/// in every exposure.
class PoseTrack {
 public:
  /// `fractions` of the exposure, in [0, 1], or later.
  void set(const Scene& scene, const Exposures& exposures, std::size_t exposure,
           const std::vector<double>& fractions, const Rigid3& sensor_from_reference);

  /// One instant, poses of bodies given directly in the frame in which rays will be given.
  void set_still(const Scene& scene, const Rigid3* reference_from_body);

  std::size_t instants() const { return instants_; }
  const Rigid3& reference_from_light(std::size_t light, std::size_t instant) const {
    return reference_from_light_[light * instants_ + instant];
  }
  const Rigid3& shape_from_reference(std::size_t shape, std::size_t instant) const {
    return shape_from_reference_[shape * instants_ + instant];
  }

 private:
  void place_lights(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                    const std::vector<double>& fractions);

  std::size_t instants_ = 0;
  std::vector<Rigid3> shape_from_reference_;
  std::vector<Rigid3> reference_from_light_;
  std::vector<Rigid3> reference_from_world_;
};

/// Number that keys the noise of an image: one with the laser off has its own.
inline std::int64_t frame_number(const Exposures& exposures, std::size_t exposure, bool laser_on) {
  const std::int64_t index = exposures.index[exposure];
  return laser_on ? index : -1 - index;
}

/// Pose at a fraction of the exposure, from evenly spaced samples; beyond its end things go on as they were
/// going.
Rigid3 pose_at(const Rigid3* poses, std::size_t samples, double fraction);

}  // namespace sensor_rt
