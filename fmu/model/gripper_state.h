// What a gripper is told, remembers and shows.
#pragma once

#include <array>
#include <cstdint>

namespace robotcell {

enum class GripperMode : std::int32_t { kKeep, kWidth, kForce };

/// What the gripper is told to do. Force and width beyond what it can do are brought into its range.
struct GripperCommand {
  GripperMode mode = GripperMode::kKeep;  // kKeep: go on with the last command
  double width = 0;                       // m between the pads, for kWidth
  double force = 0;                       // N of each finger, for kForce
};

/// All that a gripper remembers between two steps.
struct GripperState {
  GripperCommand command;           // that it is at work on; never kKeep
  std::array<double, 2> opening{};  // of each finger from the middle, m
  std::array<double, 2> speed{};    // m/s
  double drive_force = 0;           // mean closing force of the drives, N
};

/// A gripper as it is seen at a point of the dynamics grid.
struct GripperPoint {
  std::array<double, 2> opening{};                       // of each finger from the middle, m
  std::array<double, 2> normal_force{};                  // of each pad on parts, N
  std::array<std::array<double, 3>, 2> contact_force{};  // the same with friction, world, N
  double force = 0;                                      // closing, of the drives, N
  bool gripped = false;
};

}  // namespace robotcell
