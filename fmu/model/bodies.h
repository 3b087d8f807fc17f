// True poses and twists of the bodies of the cell.
#pragma once

#include <array>

#include "fmu/model/cell_layout.h"
#include "fmu/model/fields.h"

namespace robotcell {

/// Pose and twist of a body frame in the world; the velocity is that of the frame origin.
struct BodyState {
  std::array<double, 3> position{};
  std::array<double, 4> orientation{1, 0, 0, 0};  // quaternion w, x, y, z with w >= 0
  std::array<double, 3> velocity{};
  std::array<double, 3> angular_velocity{};

  template <class Visitor>
  static void declare(Visitor& visit, BodyState& b) {
    visit(b, state(b.position, "position"), state(b.orientation, "orientation"),
          state(b.velocity, "velocity"), state(b.angular_velocity, "angular_velocity"));
  }
};

/// Poses and twists of all bodies of the cell.
struct Bodies {
  explicit Bodies(const CellLayout& layout)
      : axes(layout.axes.size()),
        links(layout.joints.size()),
        parts(layout.parts.size()),
        fingers(layout.gripper ? 2 : 0),
        further_sensors(layout.further_sensors.size()) {}

  PerDevice<BodyState> axes;  // what the further axes carry
  PerDevice<BodyState> links;
  BodyState sensor, table;
  PerDevice<BodyState> parts, fingers, further_sensors;

  template <class Visitor>
  static void declare(Visitor& visit, Bodies& b) {
    visit(b, state(b.axes, "axes"), state(b.links, "links"), state(b.sensor, "sensor"),
          state(b.table, "table"), state(b.parts, "parts"), state(b.fingers, "fingers"),
          state(b.further_sensors, "further_sensors"));
  }
};

}  // namespace robotcell
