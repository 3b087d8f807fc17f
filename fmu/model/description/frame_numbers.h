// Frames of the cell that bodies, parts and sensors are attached to.
#pragma once

#include <cstddef>

#include "fmu/kinematics/tree.h"

namespace robotcell {

class JsonReader;

/// Numbers of the frames of a cell with so many devices: those of its tree, then fingers and parts.
struct FrameNumbers {
  std::size_t joints = 0, conveyors = 0, fingers = 0, parts = 0, axes = 0, further_sensors = 0;

  /// The frame that a further axis carries. These come before arm and table, which they may carry.
  std::size_t axis(std::size_t i) const { return kWorld + 1 + i; }
  std::size_t base() const { return axis(axes); }
  /// Behind a joint of the arm (Denavit-Hartenberg).
  std::size_t joint(std::size_t i) const { return base() + 1 + i; }
  /// The last link is the flange, which vibrates behind its joint.
  std::size_t link(std::size_t i) const { return i + 1 < joints ? joint(i) : flange(); }
  std::size_t flange() const { return joint(joints); }
  std::size_t sensor() const { return flange() + 1; }
  std::size_t table() const { return flange() + 2; }  // carries the axis of the platter
  std::size_t platter() const { return flange() + 3; }
  /// Beside that of the tool; anything before carries it.
  std::size_t further_sensor(std::size_t i) const { return platter() + 1 + i; }
  std::size_t conveyor(std::size_t i) const { return further_sensor(further_sensors) + i; }  // at rest
  std::size_t finger(std::size_t i) const { return conveyor(conveyors) + i; }
  std::size_t part(std::size_t i) const { return finger(fingers) + i; }

  /// The frame that a description names; throws DescriptionError where the cell has none.
  std::size_t parse(const JsonReader& json) const;
};

}  // namespace robotcell
