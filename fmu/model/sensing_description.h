// Presence and distance sensors, collision outputs, and the bodies that they see.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "fmu/proximity/body_set.h"

namespace robotcell {

class JsonReader;

/// A frame of the cell that bodies and sensors move with.
struct FrameRef {
  enum class Kind { kWorld, kLink, kSensor, kTable, kPart, kFinger };
  Kind kind = Kind::kWorld;
  std::size_t index = 0;  // of the link, part or finger, counted from 0

  bool operator==(const FrameRef& other) const { return kind == other.kind && index == other.index; }
};

/// How many frames of a kind a cell has.
struct FrameCounts {
  std::size_t parts = 0, fingers = 0;
};

/// What sensors and collision outputs see; its mesh is in the frame that it moves with.
struct BodyDescription {
  std::string name;
  FrameRef frame;
  proximity::TriangleMesh mesh;
};

/// A box that tells whether any part reaches into it; its frame lies in the box's centre.
struct PresenceSensorDescription {
  std::string name;
  FrameRef frame;
  Eigen::Isometry3d frame_from_sensor;
  Eigen::Vector3d size;
  std::int64_t period_us = 0;
};

/// Light goes out from the origin along z; what comes back enters the lens.
struct DistanceSensorDescription {
  std::string name;
  FrameRef frame;
  Eigen::Isometry3d frame_from_sensor;
  Eigen::Vector3d lens;  // sensor frame
  double nearest = 0, farthest = 0;
  double noise = 0, resolution = 0;  // m; standard deviation, and step (0: continuous)
  std::int64_t period_us = 0;
};

/// Pairs of bodies whose collisions and smallest distance are told.
struct CollisionDescription {
  bool outputs = false;
  double range = 0;                                        // m, beyond which distances are not told
  std::vector<std::pair<std::size_t, std::size_t>> pairs;  // numbers of bodies
};

struct SensingDescription {
  std::vector<BodyDescription> bodies;
  std::vector<PresenceSensorDescription> presence;
  std::vector<DistanceSensorDescription> distance;
  CollisionDescription collision;
};

/// Reads the keys "bodies", "presence_sensors", "distance_sensors" and "collision"; throws DescriptionError.
SensingDescription parse_sensing(const JsonReader& cell, const FrameCounts& counts,
                                 std::int64_t time_step_us);

}  // namespace robotcell
