#include "sensor_rt/render/stripe/stripe_samples.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace sensor_rt {
namespace {

constexpr double kStep = 0.5;         // px of motion between samples that are instants
constexpr double kInterval = 1.0;     // px of motion in the time interval of a sample
constexpr double kMaxMotion = 512.0;  // px

struct LinePoint {
  Eigen::Vector3d point;  ///< in the reference frame
  double px_per_m;        ///< largest motion in the image per motion of the point
};

/// Returns the ends of the part of the laser line that a camera sees, at both ends of the measuring range.
/// The motion of a rigid body is linear in the point, so that it is largest there.
std::vector<LinePoint> ends_of_seen_line(const SensorModel& model, const Camera& camera) {
  const Rigid3& pose = camera.sensor_from_camera;
  const Eigen::Vector3d forward = pose.rotation.col(2);
  std::vector<LinePoint> ends;
  for (const double z : {model.near, model.far}) {
    const double depth = forward.dot(Eigen::Vector3d(0.0, 0.0, z) - pose.translation);
    if (!(depth > 0.0)) continue;
    double low = std::numeric_limits<double>::infinity();
    double high = -low;
    for (const double column : {-0.5, camera.width_px - 0.5}) {
      for (const double row : {-0.5, camera.height_px - 0.5}) {
        const double y = pose.translation.y() + depth * (pose.rotation * camera.ray({column, row})).y();
        low = std::min(low, y);
        high = std::max(high, y);
      }
    }
    const double lit =
        (z - model.laser.source_z) * std::tan(model.laser.fan_half_angle) + 0.5 * model.laser.source_length;
    for (const double y : {std::clamp(low, -lit, lit), std::clamp(high, -lit, lit)}) {
      const Eigen::Vector3d point(0.0, y, z);
      const double distance = (point - pose.translation).norm();
      ends.push_back({point, camera.focal_px * distance / (depth * depth)});
    }
  }
  return ends;
}

/// Returns an upper bound of the motion, px, that points of the shapes show between the first and any other
/// instant.
double max_motion_px(const SensorModel& model, const PoseTrack& track,
                     const std::vector<std::size_t>& shapes) {
  double farthest_px = 0.0;
  for (const Camera& camera : model.cameras) {
    for (const LinePoint& end : ends_of_seen_line(model, camera)) {
      for (const std::size_t s : shapes) {
        const Eigen::Vector3d in_shape = track.shape_from_reference(s, 0) * end.point;
        for (std::size_t instant = 1; instant < track.instants(); ++instant) {
          const Eigen::Vector3d meanwhile = track.shape_from_reference(s, instant) * end.point;
          farthest_px = std::max(farthest_px, (meanwhile - in_shape).norm() * end.px_per_m);
        }
      }
    }
  }
  return farthest_px;
}

/// Returns the borders of `parts` equal parts of the interval from 0 to 1.
std::vector<double> even_fractions(std::size_t parts) {
  std::vector<double> fractions;
  for (std::size_t i = 0; i <= parts; ++i)
    fractions.push_back(static_cast<double>(i) / static_cast<double>(parts));
  return fractions;
}

/// Returns the integral of the hat function max(0, 1 - |u|) up to x.
double hat_integral(double x) {
  const double u = std::clamp(x, -1.0, 1.0);
  return 0.5 + u - 0.5 * u * std::abs(u);
}

}  // namespace

void StripeSamples::set(const RenderPlan& plan, const Scene& scene, const Exposures& exposures,
                        std::size_t exposure) {
  const auto set_track = [&](const std::vector<double>& fractions, PoseTrack& track) {
    track.set(scene, exposures, exposure, fractions, plan.sensor_from_reference);
  };
  lattice_ = plan.stripe_lattice.size();
  timing_ = {};
  motion_.clear();
  fractions_.assign(lattice_, 0.5);
  if (exposures.is_still(exposure)) return set_track(fractions_, track_);
  // Instants of the given poses, so that motion to and fro counts.
  const std::size_t steps = std::max<std::size_t>(exposures.samples - 1, 1);
  set_track(even_fractions(steps), ends_);
  laser_.set(SceneQuery(scene, ends_), {plan.lane_sources.front()}, std::vector<std::size_t>(kLanes, 0),
             plan.laser_region);
  const double motion_px = std::min(max_motion_px(plan.settings.model, ends_, laser_.shapes()), kMaxMotion);
  if (plan.settings.row_readout > 0.0) {
    timing_ = {plan.settings.model, plan.settings.row_readout, exposures.duration[exposure]};
    set_rows(motion_px);
  } else if (lattice_ > 1) {
    set_lattice(plan, motion_px);
  } else {
    // Motion that is not linear in time, unless it is small, has a sample for each of its parts.
    constexpr double kSmall = 0.1;  // px
    const auto parts = std::min(steps, static_cast<std::size_t>(std::ceil(motion_px / kSmall)));
    const std::size_t count =
        std::max({static_cast<std::size_t>(std::ceil(motion_px / kInterval)), parts, std::size_t{1}});
    fractions_.clear();
    for (std::size_t i = 0; i < count; ++i)
      fractions_.push_back((static_cast<double>(i) + 0.5) / static_cast<double>(count));
    set_track(fractions_, track_);
    set_track(even_fractions(count), ends_);
    return find_motion(scene);
  }
  set_track(fractions_, track_);
}

void StripeSamples::set_rows(double motion_px) {
  const auto wanted = static_cast<std::size_t>(std::ceil(motion_px / kStep));
  fractions_ = even_fractions(std::max({lattice_, wanted, std::size_t{1}}));
}

void StripeSamples::set_lattice(const RenderPlan& plan, double motion_px) {
  const std::size_t rounds = 1 + static_cast<std::size_t>(motion_px / kStep) / lattice_;
  const auto count = static_cast<double>(rounds * lattice_);
  fractions_.clear();
  for (std::size_t round = 0; round < rounds; ++round) {
    for (const std::size_t stratum : plan.pattern.instant) {
      fractions_.push_back((static_cast<double>(stratum * rounds + round) + 0.5) / count);
    }
  }
}

void StripeSamples::find_motion(const Scene& scene) {
  for (std::size_t s = 0; s < scene.shapes().size(); ++s) {
    for (std::size_t i = 0; i < size(); ++i) {
      motion_.push_back(Displacement::between(track_.shape_from_reference(s, i),
                                              ends_.shape_from_reference(s, i),
                                              ends_.shape_from_reference(s, i + 1)));
    }
  }
}

void StripeSamples::row_shares(const Camera& camera, std::size_t sample, std::vector<float>& shares) const {
  const auto rows = static_cast<std::size_t>(camera.height_px);
  if (timing_.readout == 0.0) {
    shares.assign(rows, 1.0f / static_cast<float>(size()));
    return;
  }
  shares.resize(rows);
  const auto steps = static_cast<double>(size() - 1);
  const double open = timing_.open / timing_.span();
  for (int row = 0; row < camera.height_px; ++row) {
    const double start = timing_.start(timing_.half_rows(camera, row)) / timing_.span();
    const double from = (start - fractions_[sample]) * steps;
    const double to = (start + open - fractions_[sample]) * steps;
    shares[static_cast<std::size_t>(row)] =
        static_cast<float>((hat_integral(to) - hat_integral(from)) / (to - from));
  }
}

}  // namespace sensor_rt
