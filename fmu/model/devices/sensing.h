// Readings of all sensors and of the collision monitor.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "fmu/model/cell_values.h"
#include "fmu/model/description/cell_description.h"
#include "fmu/proximity/body_set.h"
#include "fmu/proximity/pair_monitor.h"

namespace robotcell {

/// Each device reads at the multiples of its period, for the first time after one period, and holds its
/// reading in between. The collision monitor reads once per controller cycle, and unless its collisions are
/// only sampled it follows the bodies in between. Readings depend on poses and time only.
class Sensing {
 public:
  /// `bodies` in the order of the description.
  Sensing(const CellDescription& cell, const proximity::BodySet& bodies, std::int32_t instance_seed);

  /// Sets values before the first reading.
  void initialize(Readings& readings) const;

  /// Throws std::invalid_argument where the readings belong to another cell.
  void check(const Readings& readings) const;

  /// Starts at these poses of all frames, without a reading.
  void place(const std::vector<Motion>& frames);

  /// Whether any device reads, or the bodies are followed, at this instant.
  bool due(std::int64_t time_us) const;

  /// Updates the devices that read at this instant; `frames` holds the poses of all frames then.
  void read(std::int64_t time_us, const std::vector<Motion>& frames, Readings& readings);

 private:
  class View;

  std::optional<proximity::Nearest> nearest_of(const CollisionReading& reading) const;
  void set_poses(const std::vector<Motion>& frames);
  void follow_bodies(CollisionReading& reading);
  void read_collisions(CollisionReading& reading);

  SensingDescription description_;
  std::int64_t collision_period_us_;
  std::uint64_t key_;
  proximity::BodySet bodies_;
  proximity::PairMonitor pair_monitor_;
  std::array<std::vector<proximity::Selection>, kSensorKinds> visible_;  // bodies, by kind and sensor
};

}  // namespace robotcell
