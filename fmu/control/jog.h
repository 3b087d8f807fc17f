// Jogging: motion commanded by hand, for as long as the command is held.
#pragma once

#include <optional>

#include "fmu/control/arm_geometry.h"
#include "fmu/control/command.h"
#include "fmu/control/path_ahead.h"

namespace robotcell::control {

/// Limits of jogging; speeds are those at full deflection. Accelerations limit how fast the commanded motion
/// changes, in joint and Cartesian jogs; a released joint jog brakes as fast as the axes can.
struct JogLimits {
  double joint_share = 0;           // fraction of each axis' maximum speed and acceleration
  double line_speed = 0;            // m/s, of the tool; limits joint jogs, too
  double angular_speed = 0;         // rad/s, of the tool
  double line_acceleration = 0;     // m/s^2
  double angular_acceleration = 0;  // rad/s^2
};

/// Twist of the tool, world axes, and rate of the table.
using JogSpeed = Eigen::Matrix<double, 7, 1>;

struct JogState {
  bool brakes_first = false;  // a Cartesian jog that began or was taken up again in motion
  bool blocked = false;       // stopped by a limit or a singularity; cleared when the jog is released
  ControllerError error = ControllerError::kNone;
  std::int32_t limit = 0;
  JogSpeed speed = JogSpeed::Zero();
  Eigen::Vector3d position =
      Eigen::Vector3d::Zero();  // of the tool, world; the reference integrated by the jog
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
};

class Jog {
 public:
  Jog(const ArmGeometry& arm, const Limits& limits, const JogLimits& jog)
      : arm_(arm), limits_(limits), jog_(jog) {}

  /// Starts a jog.
  void enter(const Knots& present);

  /// Deflections of a command: in a Cartesian jog those of translation and of rotation have norms of at
  /// most 1.
  static Axes deflection(const Command& command);

  /// Share of the full speed of a jog in the same direction: the largest deflection of an axis, in a
  /// Cartesian jog of translation, rotation or table.
  static double share_of_full(Mode mode, const Axes& deflection);

  /// Positions `step` seconds apart of a jog that holds the deflection of `command`, or the present speed
  /// where that is higher. Limits do not end it: where the inverse kinematics fails, a singularity ends the
  /// jog, or the jog brakes, the axes keep their speeds.
  PathAhead path_ahead(const Command& command, const Knots& present, double step) const;

  /// Present speed as a share of the speed of `path_ahead`, 0 to 1.
  double share_of_ahead(const Command& command, const Knots& present) const;

  /// The arm is moved by something else: a Cartesian jog that goes on comes to rest first.
  void interrupt() { state_.brakes_first = true; }

  /// State of the axes at the end of the next cycle (`cycle` in seconds). A Cartesian jog that a limit has
  /// ended goes on after the operator has `released` it, not where a guard merely permits no speed: its path
  /// begins anew.
  Knots joints(double cycle, const Command& command, const Knots& present);
  Knots cartesian(double cycle, const Command& command, bool released, const Knots& present);

  const JogState& state() const { return state_; }
  void restore(const JogState& state) { state_ = state; }

 private:
  struct Attempt;
  Axes joint_rates(const Command& command, const Jacobian& jacobian) const;
  double change_ratio(const Axes& change, const Jacobian& jacobian, double cycle) const;
  bool enters_singularity(const Axes& present, const Jacobian& columns) const;
  bool move_on(double time, JogFrame frame, JogSpeed& speed, Eigen::Isometry3d& pose, Axes& position) const;
  JogSpeed commanded_speed(const Command& command, double later) const;
  JogSpeed ramped(const JogSpeed& wanted, double cycle) const;
  std::optional<Attempt> attempt(const JogSpeed& speed, double cycle, const Knots& present) const;
  std::optional<Attempt> within_limits(double cycle, const Command& command, const Knots& present) const;
  bool reaches_limit(const Attempt& attempt, double cycle, const Knots& present);
  Knot axis(std::size_t i, double wanted, double cycle, const Knots& present);
  void block(ControllerError error, int limit);

  const ArmGeometry& arm_;
  const Limits& limits_;
  JogLimits jog_;
  JogState state_;
};

/// Whether no deflection is commanded.
bool jog_released(const Command& command);

/// One cycle of braking that scales the speeds of all axes by the same factor, so that the direction of the
/// tool is kept and no axis exceeds its acceleration limit. An axis that would pass a position limit brakes
/// on its own, as fast as it can.
Knots brake_synchronously(double cycle, const Limits& limits, const Knots& present);

}  // namespace robotcell::control
