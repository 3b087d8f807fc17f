// Command, state and readings of a gripper.
#pragma once

#include <array>
#include <cstdint>

#include "fmu/control/enumeration.h"

namespace robotcell {

enum class GripperMode : std::int32_t { kKeep, kWidth, kForce };
inline constexpr EnumerationItem kGripperModeItems[] = {
    {"keep", "keep the last command (at the start: hold the width)"},
    {"width", "move to command.gripper.width"},
    {"force", "close with command.gripper.force"},
};
template <>
inline constexpr Enumeration enumeration_of<GripperMode> = make_enumeration("GripperMode", kGripperModeItems);

/// Command to the gripper; force and width are clamped to its range.
struct GripperCommand {
  GripperMode mode = GripperMode::kKeep;  // kKeep: the last command stays active
  double width = 0;                       // m, between the pads, for kWidth
  double force = 0;                       // N, of each finger, for kForce
};

/// Complete state of a gripper between two steps.
struct GripperState {
  GripperCommand command;           // active command; never kKeep
  std::array<double, 2> opening{};  // m, of each finger from the middle
  std::array<double, 2> speed{};    // m/s
  double drive_force = 0;           // N, mean closing force of the drives
};

/// Readings of a gripper at a point of the dynamics grid.
struct GripperPoint {
  std::array<double, 2> opening{};       // of each finger from the middle, m
  std::array<double, 2> normal_force{};  // N, of each pad on the parts
  std::array<std::array<double, 3>, 2>
      contact_force{};  // N, of each pad on the parts, friction included, world axes
  double force = 0;     // N, closing force of the drives
  bool gripped = false;
};

}  // namespace robotcell
