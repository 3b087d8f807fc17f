#include "fmu/model/devices/sensing.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "fmu/control/time_units.h"
#include "fmu/model/random.h"

namespace robotcell {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

/// Numbers between the random keys of two kinds of sensors.
constexpr std::uint64_t kSensorKeys = 1u << 20;

/// Bodies visible to a sensor: all but those in its own frame; a sensor fixed in the world sees all.
proximity::Selection visible_bodies(const SensorMount& mount, const std::vector<BodyDescription>& bodies) {
  proximity::Selection visible;
  for (const BodyDescription& body : bodies) {
    visible.push_back(mount.frame == kWorld || body.frame != mount.frame);
  }
  return visible;
}

/// m: a collision that becomes deeper by less is not reported as deeper.
constexpr double kDeeper = 1e-4;

PairCollision pair_collision(const proximity::Collision& found) {
  const Vector3d& point = found.point;
  return {static_cast<std::int32_t>(found.pair), found.depth, {point.x(), point.y(), point.z()}, found.depth};
}

std::vector<PairCollision>::const_iterator find_pair(const std::vector<PairCollision>& collisions,
                                                     std::int32_t pair) {
  return std::find_if(collisions.begin(), collisions.end(), [pair](const auto& c) { return c.pair == pair; });
}

std::int32_t one_based(std::size_t body) { return static_cast<std::int32_t>(body) + 1; }

}  // namespace

/// What one sensor sees at an instant.
class Sensing::View : public SensorView {
 public:
  View(const Sensing& sensing, const proximity::Selection& visible, const Isometry3d& world_from_sensor,
       std::uint64_t key, std::int64_t time_us)
      : sensing_(sensing),
        visible_(visible),
        world_from_sensor_(world_from_sensor),
        key_(key),
        time_us_(time_us) {}

  Isometry3d world_from_sensor() const override { return world_from_sensor_; }
  double time() const override { return static_cast<double>(time_us_) * kSecondsPerMicrosecond; }
  double noise() const override { return normal(mixed(mixed(key_) ^ static_cast<std::uint64_t>(time_us_))); }
  bool body_in_box(const Isometry3d& world_from_box, const Vector3d& size) const override {
    for (std::size_t i = 0; i < sensing_.bodies_.size(); ++i) {
      if (visible_[i] && sensing_.bodies_.intersects_box(i, world_from_box, size)) return true;
    }
    return false;
  }
  std::optional<double> cast_ray(const Vector3d& origin, const Vector3d& direction, double nearest,
                                 double farthest) const override {
    const auto hit = sensing_.bodies_.cast_ray(origin, direction, nearest, farthest, visible_);
    return hit ? std::optional<double>(hit->distance) : std::nullopt;
  }

 private:
  const Sensing& sensing_;
  const proximity::Selection& visible_;
  const Isometry3d& world_from_sensor_;
  std::uint64_t key_;
  std::int64_t time_us_;
};

Sensing::Sensing(const CellDescription& cell, const proximity::BodySet& bodies, std::int32_t instance_seed)
    : description_(cell.sensing),
      collision_period_us_(cell.controller_cycle_us),
      key_(mixed(key_of_seeds(cell.seed, instance_seed) ^ mixed(0x5e45e5u))),
      bodies_(bodies),
      pair_monitor_(cell.sensing.collision.pairs) {
  for_each_sensor_kind([this](auto kind) {
    for (const auto& sensor : std::get<kind>(description_.sensors)) {
      visible_[kind].push_back(visible_bodies(sensor.mount, description_.bodies));
    }
  });
}

void Sensing::initialize(Readings& readings) const {
  if (description_.collision.outputs) readings.collision.clearance = description_.collision.range;
}

bool Sensing::due(std::int64_t time_us) const {
  const CollisionDescription& collision = description_.collision;
  bool due = collision.outputs && (collision.swept || time_us % collision_period_us_ == 0);
  for_each_sensor_kind([&](auto kind) {
    for (const auto& sensor : std::get<kind>(description_.sensors)) {
      due = due || time_us % sensor.mount.period_us == 0;
    }
  });
  return due;
}

void Sensing::check(const Readings& readings) const {
  for (const auto* collisions : {&readings.collision.colliding, &readings.collision.passed}) {
    for (const PairCollision& collision : *collisions) {
      const auto pair = static_cast<std::size_t>(collision.pair);
      if (collision.pair >= 0 && pair < description_.collision.pairs.size()) continue;
      throw std::invalid_argument("the state belongs to a cell with other pairs of bodies");
    }
  }
}

void Sensing::place(const std::vector<Motion>& frames) {
  set_poses(frames);
  pair_monitor_.begin(bodies_);
}

void Sensing::set_poses(const std::vector<Motion>& frames) {
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    bodies_.set_pose(i, frames[description_.bodies[i].frame].pose);
  }
}

void Sensing::read(std::int64_t time_us, const std::vector<Motion>& frames, Readings& readings) {
  set_poses(frames);
  for_each_sensor_kind([&](auto kind) {
    const auto& sensors = std::get<kind>(description_.sensors);
    for (std::size_t i = 0; i < sensors.size(); ++i) {
      const SensorMount& mount = sensors[i].mount;
      if (time_us % mount.period_us != 0) continue;
      const Isometry3d world_from_sensor = frames[mount.frame].pose * mount.frame_from_sensor;
      const std::uint64_t key = key_ + kSensorKeys * kind + i;
      std::get<kind>(readings.sensors)[i] =
          sensors[i].read(View(*this, visible_[kind][i], world_from_sensor, key, time_us));
    }
  });
  const CollisionDescription& collision = description_.collision;
  if (collision.outputs && collision.swept) follow_bodies(readings.collision);
  if (collision.outputs && time_us % collision_period_us_ == 0) read_collisions(readings.collision);
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

/// Adds the pairs that have collided since the last call, and did not collide at the last cycle.
void Sensing::follow_bodies(CollisionReading& reading) {
  proximity::Selection known(description_.collision.pairs.size(), false);
  for (const auto* collisions : {&reading.colliding, &reading.passed}) {
    for (const PairCollision& collision : *collisions) known[static_cast<std::size_t>(collision.pair)] = true;
  }
  for (const proximity::Collision& found : pair_monitor_.follow(bodies_, known)) {
    reading.passed.push_back(pair_collision(found));
  }
}

void Sensing::read_collisions(CollisionReading& reading) {
  const CollisionReading before = reading;
  reading = {};
  reading.clearance = description_.collision.range;
  for (const proximity::Collision& found : pair_monitor_.collisions(bodies_)) {
    PairCollision& collision = reading.colliding.emplace_back(pair_collision(found));
    const auto known = find_pair(before.colliding, collision.pair);
    if (known == before.colliding.end()) {
      reading.begins = true;
    } else if (collision.depth > known->least_depth + kDeeper) {
      reading.deepens = true;
    } else {
      collision.least_depth = std::min(known->least_depth, collision.depth);
    }
  }
  std::vector<PairCollision> collisions = reading.colliding;
  for (const PairCollision& passed : before.passed) {
    if (find_pair(reading.colliding, passed.pair) != reading.colliding.end()) continue;
    collisions.push_back(passed);
    reading.begins = true;
  }
  reading.pairs = static_cast<std::int32_t>(collisions.size());
  if (!collisions.empty()) {
    const auto deepest = std::max_element(collisions.begin(), collisions.end(),
                                          [](const auto& a, const auto& b) { return a.depth < b.depth; });
    const auto& pair = pair_monitor_.pair(static_cast<std::size_t>(deepest->pair));
    reading.body_a = reading.near_a = one_based(pair.first);
    reading.body_b = reading.near_b = one_based(pair.second);
    reading.depth = deepest->depth;
    reading.point = deepest->point;
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
