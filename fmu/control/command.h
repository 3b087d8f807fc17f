// What the controller is told, and what it says.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>

#include "fmu/control/axis.h"

namespace robotcell::control {

enum class Mode : std::int32_t { kHold, kServo, kJointMove, kLineMove, kJointJog, kCartesianJog };
enum class Operation : std::int32_t { kManual, kAutomatic };
enum class JogFrame : std::int32_t { kWorld, kTool };

struct Command {
  Mode mode = Mode::kHold;
  Axes position{};                                         // set-points and targets, rad
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();  // target of a line, world_from_tool
  double speed = 1;                                        // share of the full speed, above 0
  double monitor_speed = 1;                                // 0..1
  Axes jog{};                                              // -1..1
  JogFrame jog_frame = JogFrame::kWorld;
  Operation operation = Operation::kAutomatic;
  std::int32_t start = 0;  // every increase starts a move
  bool emergency_stop = false;
  std::int32_t reset = 0;      // every increase ends an emergency stop
  std::int32_t heartbeat = 0;  // every change shows that the sender lives
  double max_age = 0;          // s; 0: for ever
};

enum class Phase : std::int32_t { kRest, kMoving, kBraking, kEmergencyStop };

/// Why the controller does not do what it is told.
enum class Refusal : std::int32_t {
  kNone,
  kManualOperation,     // a program's mode in manual operation
  kAutomaticOperation,  // a jog in automatic operation
  kEmergencyStop,       // stopped, and not reset yet
  kTooOld,              // no heartbeat
  kTargetOutOfLimits,
  kPathOutOfLimits,
  kSingular,
};

struct Report {
  Mode mode = Mode::kHold;
  Phase phase = Phase::kRest;
  Refusal refusal = Refusal::kNone;
  std::int32_t limit = 0;  // 1..7: axis that a limit keeps back; 0: none
  bool moving = false;
  bool at_destination = false;
  double progress = 0;
  Axes destination{};
};

}  // namespace robotcell::control
