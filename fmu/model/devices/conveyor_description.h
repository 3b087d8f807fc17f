// Belt conveyors.
#pragma once

#include <Eigen/Geometry>
#include <string>

namespace robotcell {

class JsonReader;

struct ConveyorDescription {
  std::string name;
  Eigen::Isometry3d
      world_from_belt;  // origin in the centre of the top face, x along the motion of the belt, z up
  double length = 0, width = 0, thickness = 0;
  double max_speed = 0, max_acceleration = 0, friction = 0;
};

/// Throws DescriptionError.
ConveyorDescription parse_conveyor(const JsonReader& json);

}  // namespace robotcell
