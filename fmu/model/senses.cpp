#include "fmu/model/senses.h"

#include <algorithm>
#include <cmath>

#include "fmu/model/random.h"

namespace robotcell {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

constexpr double kSecondsPerTick = 1e-6;
/// A second ray starts this far from the surface that sent it back (m).
constexpr double kOffSurface = 1e-7;

Isometry3d pose_of(const BodyState& body) {
  const auto& q = body.orientation;
  return Eigen::Translation3d(body.position[0], body.position[1], body.position[2]) *
         Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
}

std::vector<proximity::TriangleMesh> meshes_of(const SensingDescription& sensing) {
  std::vector<proximity::TriangleMesh> meshes;
  for (const BodyDescription& body : sensing.bodies) meshes.push_back(body.mesh);
  return meshes;
}

/// A sensor sees everything but what moves with it; what stands in the world sees whatever else stands there.
proximity::Selection seen_by(const DistanceSensorDescription& sensor,
                             const std::vector<BodyDescription>& bodies) {
  proximity::Selection seen;
  for (const BodyDescription& body : bodies) {
    seen.push_back(sensor.frame.kind == FrameRef::Kind::kWorld || !(body.frame == sensor.frame));
  }
  return seen;
}

std::int32_t told(std::size_t body) { return static_cast<std::int32_t>(body) + 1; }

}  // namespace

Senses::Senses(const CellDescription& cell, std::int32_t instance_seed)
    : sensing_(cell.sensing),
      collision_period_us_(cell.controller_cycle_us),
      key_(mixed(key_of_seeds(cell.seed, instance_seed) ^ mixed(0x5e45e5u))),
      bodies_(meshes_of(cell.sensing)),
      pairs_(cell.sensing.collision.pairs) {
  for (const DistanceSensorDescription& sensor : sensing_.distance) {
    seen_.push_back(seen_by(sensor, sensing_.bodies));
  }
}

Readings Senses::nothing() const {
  Readings readings;
  readings.presence.resize(sensing_.presence.size());
  readings.distance.resize(sensing_.distance.size());
  if (sensing_.collision.outputs) readings.collision.clearance = sensing_.collision.range;
  return readings;
}

bool Senses::due(std::int64_t time_us) const {
  const auto reads = [time_us](const auto& sensor) { return time_us % sensor.period_us == 0; };
  return (sensing_.collision.outputs && time_us % collision_period_us_ == 0) ||
         std::any_of(sensing_.presence.begin(), sensing_.presence.end(), reads) ||
         std::any_of(sensing_.distance.begin(), sensing_.distance.end(), reads);
}

void Senses::read(std::int64_t time_us, const Bodies& truth, Readings& readings) {
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    bodies_.place(i, frame_pose(sensing_.bodies[i].frame, truth));
  }
  for (std::size_t i = 0; i < sensing_.presence.size(); ++i) {
    if (time_us % sensing_.presence[i].period_us != 0) continue;
    readings.presence[i] = read_presence(sensing_.presence[i], truth);
  }
  for (std::size_t i = 0; i < sensing_.distance.size(); ++i) {
    if (time_us % sensing_.distance[i].period_us != 0) continue;
    readings.distance[i] = read_distance(i, time_us, truth);
  }
  if (sensing_.collision.outputs && time_us % collision_period_us_ == 0) read_collisions(readings.collision);
}

Isometry3d Senses::frame_pose(const FrameRef& frame, const Bodies& truth) const {
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

PresenceReading Senses::read_presence(const PresenceSensorDescription& sensor, const Bodies& truth) const {
  const Isometry3d world_from_box = frame_pose(sensor.frame, truth) * sensor.frame_from_sensor;
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    if (sensing_.bodies[i].frame.kind != FrameRef::Kind::kPart) continue;
    if (bodies_.reaches_into(i, world_from_box, sensor.size)) return {true};
  }
  return {false};
}

DistanceReading Senses::read_distance(std::size_t number, std::int64_t time_us, const Bodies& truth) const {
  const DistanceSensorDescription& sensor = sensing_.distance[number];
  DistanceReading reading;
  reading.time = static_cast<double>(time_us) * kSecondsPerTick;
  const Isometry3d world_from_sensor = frame_pose(sensor.frame, truth) * sensor.frame_from_sensor;
  const Vector3d origin = world_from_sensor.translation();
  const Vector3d direction = world_from_sensor.linear().col(2);
  const auto hit = bodies_.cast(origin, direction, 0, sensor.farthest, seen_[number]);
  if (!hit || hit->distance < sensor.nearest) return reading;
  const Vector3d spot = origin + hit->distance * direction;
  const Vector3d back = world_from_sensor * sensor.lens - spot;
  const double way = back.norm();
  if (bodies_.cast(spot, back / way, kOffSurface, way, seen_[number])) return reading;
  double measured = hit->distance;
  if (sensor.noise > 0) {
    measured += sensor.noise * normal(mixed(mixed(key_ + number) ^ static_cast<std::uint64_t>(time_us)));
  }
  if (sensor.resolution > 0) measured = sensor.resolution * std::nearbyint(measured / sensor.resolution);
  reading.valid = true;
  reading.distance = measured;
  return reading;
}

/// What was nearest last time will be near again.
std::optional<proximity::Nearest> Senses::nearest_of(const CollisionReading& reading) const {
  const auto& pairs = sensing_.collision.pairs;
  const auto found = std::find_if(pairs.begin(), pairs.end(), [&reading](const auto& pair) {
    return told(pair.first) == reading.near_a && told(pair.second) == reading.near_b;
  });
  if (found == pairs.end()) return std::nullopt;
  const auto face = [&reading](std::size_t i) { return static_cast<std::size_t>(reading.near_faces[i]); };
  return proximity::Nearest{static_cast<std::size_t>(found - pairs.begin()), {face(0), face(1)}, 0};
}

void Senses::read_collisions(CollisionReading& reading) {
  const CollisionReading before = reading;
  reading = {};
  reading.clearance = sensing_.collision.range;
  const auto collisions = pairs_.collisions(bodies_);
  reading.pairs = static_cast<std::int32_t>(collisions.size());
  if (!collisions.empty()) {
    const auto deepest = std::max_element(collisions.begin(), collisions.end(),
                                          [](const auto& a, const auto& b) { return a.depth < b.depth; });
    const auto& pair = pairs_.pair(deepest->pair);
    reading.body_a = reading.near_a = told(pair.first);
    reading.body_b = reading.near_b = told(pair.second);
    reading.depth = deepest->depth;
    Eigen::Map<Vector3d>(reading.point.data()) = deepest->point;
    reading.clearance = 0;
    return;
  }
  const auto nearest = pairs_.nearest(bodies_, sensing_.collision.range, nearest_of(before));
  if (!nearest) return;
  const auto& pair = pairs_.pair(nearest->pair);
  reading.clearance = nearest->distance;
  reading.near_a = told(pair.first);
  reading.near_b = told(pair.second);
  reading.near_faces = {static_cast<std::int32_t>(nearest->faces.first),
                        static_cast<std::int32_t>(nearest->faces.second)};
}

}  // namespace robotcell
