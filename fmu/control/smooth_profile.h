// Rest-to-rest speed profile with continuous acceleration.
#pragma once

namespace robotcell::control {

struct ProfileLimits {
  double speed = 0;
  double acceleration = 0;
  double jerk = 0;
};

struct ProfilePoint {
  double position = 0;
  double velocity = 0;
  double acceleration = 0;
};

/// Accelerates along 3 u^2 - 2 u^3, cruises, and decelerates symmetrically. A ramp of duration t to the speed
/// v covers v t / 2; its peak acceleration is 3 v / (2 t), its peak jerk 6 v / t^2.
struct SmoothProfile {
  double distance = 0;
  double speed = 0;  // cruising speed
  double ramp = 0;   // s, duration of each ramp

  /// The fastest profile of this form over a positive distance within the limits.
  static SmoothProfile over(double distance, const ProfileLimits& limits);

  double duration() const { return speed > 0 ? distance / speed + ramp : 0; }

  /// Constant before the start and after the end.
  ProfilePoint at(double time) const;
};

}  // namespace robotcell::control
