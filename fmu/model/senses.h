// What the cell's sensors and its collision watch read.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "fmu/model/cell_description.h"
#include "fmu/model/cell_values.h"
#include "fmu/proximity/body_set.h"
#include "fmu/proximity/pair_watch.h"

namespace robotcell {

/// The last readings of all devices.
struct Readings {
  std::vector<PresenceReading> presence;
  std::vector<DistanceReading> distance;
  CollisionReading collision;
};

/// Every device reads at the multiples of its own period, first when one period has passed, and keeps its
/// reading in between. The collision watch reads at the controller's cycle. Readings follow from the poses
/// and the time alone.
class Senses {
 public:
  Senses(const CellDescription& cell, std::int32_t instance_seed);

  /// Before anything was read.
  Readings nothing() const;

  /// Whether any device reads at this instant.
  bool due(std::int64_t time_us) const;

  /// Replaces the readings of the devices that read at this instant; `truth` holds where everything is then.
  void read(std::int64_t time_us, const Bodies& truth, Readings& readings);

 private:
  Eigen::Isometry3d frame_pose(const FrameRef& frame, const Bodies& truth) const;
  PresenceReading read_presence(const PresenceSensorDescription& sensor, const Bodies& truth) const;
  DistanceReading read_distance(std::size_t number, std::int64_t time_us, const Bodies& truth) const;
  std::optional<proximity::Nearest> nearest_of(const CollisionReading& reading) const;
  void read_collisions(CollisionReading& reading);

  SensingDescription sensing_;
  std::int64_t collision_period_us_;
  std::uint64_t key_;
  proximity::BodySet bodies_;
  proximity::PairWatch pairs_;
  std::vector<proximity::Selection> seen_;  // by each distance sensor
};

}  // namespace robotcell
