// Properties that determine the variables of a cell: the number of devices of each kind, and the dependencies
// of initial values.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "fmu/model/description/frame_numbers.h"
#include "fmu/model/devices/sensors.h"
#include "fmu/model/per_device.h"

namespace robotcell {

/// Beside the sensor of the tool.
constexpr std::size_t kMaxFurtherSensors = 7;

struct JointLayout {
  bool parallel_to_next = false;  // its axis is parallel to that of the next joint: a deviation beta exists
};

struct AxisLayout {
  std::string name;
  bool slides = false;
  std::size_t moves_with = kWorld;  // frame: initial poses depend on what moves it

  bool operator==(const AxisLayout& other) const {
    return name == other.name && slides == other.slides && moves_with == other.moves_with;
  }
};

/// Derived from a description; equal layouts have the same variable table.
struct CellLayout {
  std::vector<JointLayout> joints;
  std::vector<AxisLayout> axes;                                      // beside joints and table
  std::size_t robot_moves_with = kWorld, table_moves_with = kWorld;  // frames
  std::vector<std::size_t> further_sensors;                          // frames that carry them
  std::optional<std::size_t> sensor_moves_with;                      // frame; empty: the flange
  std::vector<std::size_t> parts;  // frames on which they start: initial poses depend on what moves these
  std::size_t conveyors = 0;
  bool gripper = false;
  std::array<std::size_t, kSensorKinds> sensors{};  // by kind
  bool collision_outputs = false;
  std::vector<std::string> bodies;  // names of the bodies that collision outputs refer to by number
  bool dynamic_drives = false;

  FrameNumbers frames() const {
    return {joints.size(), conveyors, gripper ? 2u : 0u, parts.size(), axes.size(), further_sensors.size()};
  }
};

/// Whether the arm holds part 1 on its flange.
inline bool holds_part(const CellLayout& layout) {
  return !layout.parts.empty() && layout.parts.front() == layout.frames().flange();
}

/// Difference between two layouts as text, for example "2 parts instead of 1"; empty where they are equal.
std::string difference(const CellLayout& layout, const CellLayout& expected);

}  // namespace robotcell
