// Description of presence sensors, distance sensors and collision outputs, and of the bodies they detect.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "fmu/model/frame_ref.h"
#include "fmu/proximity/body_set.h"

namespace robotcell {

class JsonReader;

/// A body that is visible to sensors and collision outputs.
struct BodyDescription {
  std::string name;
  FrameRef frame;
};

/// A box that detects whether any part intersects it; the frame is in its centre.
struct PresenceSensorDescription {
  std::string name;
  FrameRef frame;
  Eigen::Isometry3d frame_from_sensor;
  Eigen::Vector3d size;
  std::int64_t period_us = 0;
};

/// The ray starts at the origin along z; light returns to the lens.
struct DistanceSensorDescription {
  std::string name;
  FrameRef frame;
  Eigen::Isometry3d frame_from_sensor;
  Eigen::Vector3d lens;  // sensor frame
  double nearest = 0, farthest = 0;
  double noise = 0, resolution = 0;  // m; standard deviation, and step (0: not quantized)
  std::int64_t period_us = 0;
};

/// Pairs of bodies monitored for collisions and smallest distance.
struct CollisionDescription {
  bool outputs = false;
  bool stops_arm = false;                                  // emergency stop when a collision begins
  double range = 0;                                        // m, maximum distance that is reported
  std::vector<std::pair<std::size_t, std::size_t>> pairs;  // zero-based body numbers
};

struct SensingDescription {
  std::vector<BodyDescription> bodies;
  std::vector<proximity::TriangleMesh> meshes;  // of the bodies, each in the frame it is attached to
  std::vector<PresenceSensorDescription> presence;
  std::vector<DistanceSensorDescription> distance;
  CollisionDescription collision;
};

/// Reads the keys "bodies", "presence_sensors", "distance_sensors" and "collision"; throws DescriptionError.
SensingDescription parse_sensing(const JsonReader& cell, const FrameCounts& counts,
                                 std::int64_t time_step_us);

}  // namespace robotcell
