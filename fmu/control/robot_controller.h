// The robot controller: modes, operation, monitor speed, emergency stop. Knows neither the dynamics nor FMI.
#pragma once

#include <cstdint>

#include "fmu/control/arm_geometry.h"
#include "fmu/control/command.h"
#include "fmu/control/jog.h"
#include "fmu/control/programmed_move.h"
#include "fmu/control/servo_controller.h"

namespace robotcell::control {

struct ControllerSettings {
  MotionLimits motion;
  JogLimits jog;
  std::int64_t cycle_us = 0;
};

/// A move that was asked for, and waits until the axes are at rest.
struct AwaitedMove {
  bool waits = false;
  bool line = false;
  Axes position{};
  Eigen::Vector3d tool_position = Eigen::Vector3d::Zero();
  Eigen::Quaterniond tool_turn = Eigen::Quaterniond::Identity();
  double speed = 1;
};

/// All that the controller remembers.
struct ControllerState {
  ServoState servo;
  MoveState move;
  JogState jog;
  AwaitedMove awaited;
  Mode mode = Mode::kHold;  // in force
  Phase phase = Phase::kRest;
  bool stopped = false;                 // emergency stop, until it is reset
  Refusal refusal = Refusal::kNone;     // of the present command
  Refusal path_fault = Refusal::kNone;  // of the last move asked for
  std::int32_t path_limit = 0;
  std::int32_t start = 0, reset = 0, heartbeat = 0;  // counters as last seen
  std::int64_t heartbeat_us = 0;
  Axes destination{};
};

/// Once a cycle it takes a command and works out where the axes are one cycle later.
///
/// Set-points and hold follow one another at once. Every other change of mode waits until the motion in force
/// has come to rest: a programmed move stops on its path. A move starts where the axes rest when its turn
/// comes, and one that cannot be gone to its end does not start. In manual operation jogs alone move the
/// robot, in automatic operation everything else does.
class RobotController {
 public:
  RobotController(const ControllerSettings& settings, const ArmGeometry& arm, const Axes& start);
  RobotController(const RobotController&) = delete;
  RobotController& operator=(const RobotController&) = delete;

  /// To be called at every multiple of the cycle, before anything is sampled behind it.
  void cycle(std::int64_t now_us, const Command& command);

  /// Where the axes are to be, and how fast, at an instant of the running cycle.
  Knots sample(std::int64_t time_us) const { return servo_.sample(time_us); }

  Report report(std::int64_t time_us) const;

  ControllerState state() const;
  void restore(const ControllerState& state);

 private:
  void listen(std::int64_t now_us, const Command& command);
  Refusal objection(std::int64_t now_us, const Command& command) const;
  Mode mode_to_be(const Command& command) const;
  void enter(Mode mode);
  void run(std::int64_t now_us, const Command& command);
  void brake(std::int64_t now_us);
  void run_move(std::int64_t now_us, const Command& command);
  void plan(const Command& command);
  void hold(std::int64_t now_us);
  bool at_rest() const;
  const Knots& present() const { return servo_.state().end; }
  Axes present_position() const;

  ControllerSettings settings_;
  const ArmGeometry& arm_;
  double cycle_;  // s
  ServoController servo_;
  ProgrammedMove move_;
  Jog jog_;
  ControllerState state_;  // without what servo_, move_ and jog_ remember
};

}  // namespace robotcell::control
