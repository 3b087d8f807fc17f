// Jogging: motion by hand, for as long as it is asked for.
#pragma once

#include <optional>

#include "fmu/control/arm_geometry.h"
#include "fmu/control/command.h"

namespace robotcell::control {

/// Speeds of a jog at full deflection.
struct JogLimits {
  double joint_share = 0;        // of each axis' greatest speed
  double line_speed = 0;         // m/s of the tool, in joint jogs too
  double turn_speed = 0;         // rad/s of the tool
  double line_acceleration = 0;  // m/s^2
  double turn_acceleration = 0;  // rad/s^2
};

struct JogState {
  bool blocked = false;  // a limit or a singular position is near: waits until the jog is let go
  Refusal refusal = Refusal::kNone;
  std::int32_t limit = 0;
  Vector6 twist = Vector6::Zero();                     // of the tool, world
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // where the jog has led the tool
  Eigen::Quaterniond turn = Eigen::Quaterniond::Identity();
};

class Jog {
 public:
  Jog(const ArmGeometry& arm, const Limits& limits, const JogLimits& jog)
      : arm_(arm), limits_(limits), jog_(jog) {}

  /// Begins from rest.
  void enter(const Knots& present);

  /// The end of the next cycle (seconds).
  Knots joints(double cycle, const Command& command, const Knots& present);
  Knots cartesian(double cycle, const Command& command, const Knots& present);

  const JogState& state() const { return state_; }
  void restore(const JogState& state) { state_ = state; }

 private:
  struct Attempt;
  Vector6 wanted_twist(const Command& command) const;
  Vector6 ramped(const Vector6& wanted, double cycle) const;
  std::optional<Attempt> attempt(const Vector6& twist, double cycle, const Knots& present) const;
  std::optional<Attempt> within_limits(double cycle, const Command& command, const Knots& present) const;
  bool obstructed(const Attempt& attempt, double cycle, const Knots& present);
  Knot axis(std::size_t i, double wanted, double cycle, const Knots& present);
  void block(Refusal refusal, int limit);

  const ArmGeometry& arm_;
  const Limits& limits_;
  JogLimits jog_;
  JogState state_;
};

/// One cycle of braking in which all axes slow down by the same factor, so that the tool's direction stays,
/// none faster than its acceleration limit allows.
Knots brake_together(double cycle, const Limits& limits, const Knots& present);

}  // namespace robotcell::control
