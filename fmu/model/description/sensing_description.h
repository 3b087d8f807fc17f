// Description of sensors and collision outputs, and of the bodies they detect.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "fmu/model/devices/sensors.h"
#include "fmu/proximity/body_set.h"

namespace robotcell {

class JsonReader;

/// A body that is visible to sensors and collision outputs.
struct BodyDescription {
  std::string name;
  std::size_t frame = kWorld;
};

/// Pairs of bodies monitored for collisions and smallest distance.
struct CollisionDescription {
  bool outputs = false;
  bool stops_arm = false;  // emergency stop when a collision begins or deepens
  bool swept = true;       // also looks for collisions between two cycles
  double range = 0;        // m, maximum distance that is reported
  std::vector<std::pair<std::size_t, std::size_t>> pairs;  // zero-based body numbers
};

struct SensingDescription {
  std::vector<BodyDescription> bodies;
  std::vector<proximity::TriangleMesh> meshes;  // of the bodies, each in the frame it is attached to
  Sensors sensors;
  CollisionDescription collision;
};

/// Reads the keys "bodies" and "collision", and those of the sensors; throws DescriptionError.
SensingDescription parse_sensing(const JsonReader& cell, const SensorContext& context);

}  // namespace robotcell
