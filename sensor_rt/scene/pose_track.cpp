#include "sensor_rt/scene/pose_track.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {

bool Exposures::is_still(std::size_t exposure) const {
  const auto is_constant = [this](const Rigid3* poses) {
    return std::all_of(poses, poses + samples, [&](const Rigid3& pose) { return pose == poses[0]; });
  };
  if (!is_constant(sensor_poses(exposure))) return false;
  for (std::size_t body = 0; body < bodies; ++body) {
    if (!is_constant(body_poses(exposure, body))) return false;
  }
  return true;
}

Rigid3 pose_at(const Rigid3* poses, std::size_t samples, double fraction) {
  if (samples == 1) return poses[0];
  const double position = fraction * static_cast<double>(samples - 1);
  const std::size_t before = std::min(static_cast<std::size_t>(position), samples - 2);
  return interpolate(poses[before], poses[before + 1], position - static_cast<double>(before));
}

void PoseTrack::set(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                    const std::vector<double>& fractions, const Rigid3& sensor_from_reference) {
  instants_ = fractions.size();
  reference_from_world_.resize(instants_);
  for (std::size_t i = 0; i < instants_; ++i) {
    const Rigid3 world_from_sensor =
        pose_at(exposures.sensor_poses(exposure), exposures.samples, fractions[i]);
    reference_from_world_[i] = (world_from_sensor * sensor_from_reference).inverse();
  }
  const std::vector<Shape>& shapes = scene.shapes();
  shape_from_reference_.resize(shapes.size() * instants_);
  for (std::size_t s = 0; s < shapes.size(); ++s) {
    const Rigid3* poses = exposures.body_poses(exposure, static_cast<std::size_t>(shapes[s].body));
    for (std::size_t i = 0; i < instants_; ++i) {
      const Rigid3 reference_from_body =
          reference_from_world_[i] * pose_at(poses, exposures.samples, fractions[i]);
      shape_from_reference_[s * instants_ + i] = shapes[s].shape_from_body * reference_from_body.inverse();
    }
  }
  set_lights(scene, exposures, exposure, fractions);
}

void PoseTrack::set_lights(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                           const std::vector<double>& fractions) {
  const std::vector<Light>& lights = scene.lights();
  reference_from_light_.resize(lights.size() * instants_);
  for (std::size_t n = 0; n < lights.size(); ++n) {
    const Rigid3* poses = exposures.body_poses(exposure, static_cast<std::size_t>(lights[n].body));
    for (std::size_t i = 0; i < instants_; ++i) {
      reference_from_light_[n * instants_ + i] = reference_from_world_[i] *
                                                 pose_at(poses, exposures.samples, fractions[i]) *
                                                 lights[n].body_from_light;
    }
  }
}

void PoseTrack::set_still(const Scene& scene, const Rigid3* reference_from_body) {
  instants_ = 1;
  const std::vector<Shape>& shapes = scene.shapes();
  shape_from_reference_.resize(shapes.size());
  for (std::size_t s = 0; s < shapes.size(); ++s) {
    shape_from_reference_[s] = shapes[s].shape_from_body * reference_from_body[shapes[s].body].inverse();
  }
}

}  // namespace sensor_rt
