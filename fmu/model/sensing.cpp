#include "fmu/model/sensing.h"

#include <algorithm>
#include <cmath>

#include "fmu/control/time_units.h"
#include "fmu/model/random.h"

namespace robotcell {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

/// The return ray starts this far from the surface (m), to avoid hitting it again.
constexpr double kOffSurface = 1e-7;

Isometry3d pose_of(const BodyState& body) {
  const auto& q = body.orientation;
  return Eigen::Translation3d(body.position[0], body.position[1], body.position[2]) *
         Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
}

/// Bodies visible to a sensor: all but those in its own frame; a sensor fixed in the world sees all.
proximity::Selection visible_bodies(const DistanceSensorDescription& sensor,
                                    const std::vector<BodyDescription>& bodies) {
  proximity::Selection visible;
  for (const BodyDescription& body : bodies) {
    visible.push_back(sensor.frame.kind == FrameRef::Kind::kWorld || !(body.frame == sensor.frame));
  }
  return visible;
}

std::int32_t one_based(std::size_t body) { return static_cast<std::int32_t>(body) + 1; }

}  // namespace

Sensing::Sensing(const CellDescription& cell, const proximity::BodySet& bodies, std::int32_t instance_seed)
    : description_(cell.sensing),
      collision_period_us_(cell.controller_cycle_us),
      key_(mixed(key_of_seeds(cell.seed, instance_seed) ^ mixed(0x5e45e5u))),
      bodies_(bodies),
      pair_monitor_(cell.sensing.collision.pairs) {
  for (const DistanceSensorDescription& sensor : description_.distance) {
    visible_.push_back(visible_bodies(sensor, description_.bodies));
  }
}

Readings Sensing::initial_readings() const {
  Readings readings;
  readings.presence.resize(description_.presence.size());
  readings.distance.resize(description_.distance.size());
  if (description_.collision.outputs) readings.collision.clearance = description_.collision.range;
  return readings;
}

bool Sensing::due(std::int64_t time_us) const {
  const auto reads = [time_us](const auto& sensor) { return time_us % sensor.period_us == 0; };
  return (description_.collision.outputs && time_us % collision_period_us_ == 0) ||
         std::any_of(description_.presence.begin(), description_.presence.end(), reads) ||
         std::any_of(description_.distance.begin(), description_.distance.end(), reads);
}

void Sensing::read(std::int64_t time_us, const Bodies& truth, Readings& readings) {
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    bodies_.set_pose(i, frame_pose(description_.bodies[i].frame, truth));
  }
  for (std::size_t i = 0; i < description_.presence.size(); ++i) {
    if (time_us % description_.presence[i].period_us != 0) continue;
    readings.presence[i] = read_presence(description_.presence[i], truth);
  }
  for (std::size_t i = 0; i < description_.distance.size(); ++i) {
    if (time_us % description_.distance[i].period_us != 0) continue;
    readings.distance[i] = read_distance(i, time_us, truth);
  }
  if (description_.collision.outputs && time_us % collision_period_us_ == 0) {
    read_collisions(readings.collision);
  }
}

Isometry3d Sensing::frame_pose(const FrameRef& frame, const Bodies& truth) const {
  switch (frame.kind) {
    case FrameRef::Kind::kLink:
      return pose_of(truth.links[frame.index]);
    case FrameRef::Kind::kSensor:
      return pose_of(truth.sensor);
    case FrameRef::Kind::kTable:
      return pose_of(truth.table);
    case FrameRef::Kind::kPart:
      return pose_of(truth.parts[frame.index]);
    case FrameRef::Kind::kFinger:
      return pose_of(truth.fingers[frame.index]);
    case FrameRef::Kind::kWorld:
      break;
  }
  return Isometry3d::Identity();
}

PresenceReading Sensing::read_presence(const PresenceSensorDescription& sensor, const Bodies& truth) const {
  const Isometry3d world_from_box = frame_pose(sensor.frame, truth) * sensor.frame_from_sensor;
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    if (description_.bodies[i].frame.kind != FrameRef::Kind::kPart) continue;
    if (bodies_.intersects_box(i, world_from_box, sensor.size)) return {true};
  }
  return {false};
}

DistanceReading Sensing::read_distance(std::size_t number, std::int64_t time_us, const Bodies& truth) const {
  const DistanceSensorDescription& sensor = description_.distance[number];
  DistanceReading reading;
  reading.time = static_cast<double>(time_us) * kSecondsPerMicrosecond;
  const Isometry3d world_from_sensor = frame_pose(sensor.frame, truth) * sensor.frame_from_sensor;
  const Vector3d origin = world_from_sensor.translation();
  const Vector3d direction = world_from_sensor.linear().col(2);
  const auto hit = bodies_.cast_ray(origin, direction, 0, sensor.farthest, visible_[number]);
  if (!hit || hit->distance < sensor.nearest) return reading;
  const Vector3d hit_point = origin + hit->distance * direction;
  const Vector3d to_lens = world_from_sensor * sensor.lens - hit_point;
  const double return_distance = to_lens.norm();
  if (bodies_.cast_ray(hit_point, to_lens / return_distance, kOffSurface, return_distance,
                       visible_[number])) {
    return reading;
  }
  double measured = hit->distance;
  if (sensor.noise > 0) {
    measured += sensor.noise * normal(mixed(mixed(key_ + number) ^ static_cast<std::uint64_t>(time_us)));
  }
  if (sensor.resolution > 0) measured = sensor.resolution * std::nearbyint(measured / sensor.resolution);
  reading.valid = true;
  reading.distance = measured;
  return reading;
}

/// The closest pair and faces of the last reading, as the start of the next search.
std::optional<proximity::Nearest> Sensing::nearest_of(const CollisionReading& reading) const {
  const auto& pairs = description_.collision.pairs;
  const auto found = std::find_if(pairs.begin(), pairs.end(), [&reading](const auto& pair) {
    return one_based(pair.first) == reading.near_a && one_based(pair.second) == reading.near_b;
  });
  if (found == pairs.end()) return std::nullopt;
  const auto face = [&reading](std::size_t i) { return static_cast<std::size_t>(reading.near_faces[i]); };
  return proximity::Nearest{static_cast<std::size_t>(found - pairs.begin()), {face(0), face(1)}, 0};
}

void Sensing::read_collisions(CollisionReading& reading) {
  const CollisionReading before = reading;
  reading = {};
  reading.clearance = description_.collision.range;
  const auto collisions = pair_monitor_.collisions(bodies_);
  reading.pairs = static_cast<std::int32_t>(collisions.size());
  if (!collisions.empty()) {
    const auto deepest = std::max_element(collisions.begin(), collisions.end(),
                                          [](const auto& a, const auto& b) { return a.depth < b.depth; });
    const auto& pair = pair_monitor_.pair(deepest->pair);
    reading.body_a = reading.near_a = one_based(pair.first);
    reading.body_b = reading.near_b = one_based(pair.second);
    reading.depth = deepest->depth;
    Eigen::Map<Vector3d>(reading.point.data()) = deepest->point;
    reading.clearance = 0;
    return;
  }
  const auto nearest = pair_monitor_.nearest(bodies_, description_.collision.range, nearest_of(before));
  if (!nearest) return;
  const auto& pair = pair_monitor_.pair(nearest->pair);
  reading.clearance = nearest->distance;
  reading.near_a = one_based(pair.first);
  reading.near_b = one_based(pair.second);
  reading.near_faces = {static_cast<std::int32_t>(nearest->faces.first),
                        static_cast<std::int32_t>(nearest->faces.second)};
}

}  // namespace robotcell
