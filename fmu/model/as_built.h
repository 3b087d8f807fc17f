// Deviations of the cell as built from its description.
#pragma once

#include <array>

#include "fmu/model/axes_state.h"
#include "fmu/model/devices/belt.h"
#include "fmu/model/devices/table.h"
#include "fmu/model/devices/trigger.h"
#include "fmu/model/vibration.h"

namespace robotcell {

/// Deviation of one Denavit-Hartenberg row from nominal; `beta` is Hayati's rotation about y after alpha.
struct DhDeviation {
  double a = 0, d = 0, alpha = 0, theta = 0, beta = 0;

  template <class Visitor>
  static void declare(Visitor& visit, DhDeviation& d) {
    visit(d, state(d.a, "a"), state(d.d, "d"), state(d.alpha, "alpha"), state(d.theta, "theta"),
          state(d.beta, "beta"));
  }
};

/// Deviations of the cell as built from its description. All zero: the nominal cell.
struct AsBuilt {
  std::array<DhDeviation, kMaxJoints> dh{};
  std::array<double, 6> tool{};   // x, y, z (m), rx, ry, rz (rad, intrinsic XYZ): carrier_from_sensor * delta
  std::array<double, 6> grasp{};  // the same of a part on the flange: flange_from_part * delta
  std::array<double, 5> table{};  // x, y, z (m), rx, ry (rad): world_from_table * delta
  std::array<double, 2> platter{};  // x, y (m) of the platter's centre in the rotating frame
  /// Deviation of the frame of each further axis from nominal: x, y, z (m), rx, ry, rz (rad, intrinsic XYZ).
  std::array<std::array<double, 6>, kMaxFurtherAxes> axes{};
  /// Deviation of each further sensor, as that of the tool.
  std::array<std::array<double, 6>, kMaxFurtherSensors> further_sensors{};
  TableWobble wobble;
  TriggerErrors trigger;
  BeltErrors belt;
  /// Vibration of the robot base, the flange and the table, each along its own axes.
  VibrationParameters base_vibration, flange_vibration, table_vibration;

  template <class Visitor>
  static void declare(Visitor& visit, AsBuilt& b) {
    visit(b, state(b.dh, "dh"), state(b.tool, "tool"), state(b.grasp, "grasp"), state(b.table, "table"),
          state(b.platter, "platter"), state(b.axes, "axes"), state(b.further_sensors, "further_sensors"),
          state(b.wobble, "wobble"), state(b.trigger, "trigger"), state(b.belt, "belt"),
          state(b.base_vibration, "base_vibration"), state(b.flange_vibration, "flange_vibration"),
          state(b.table_vibration, "table_vibration"));
  }
};

}  // namespace robotcell
