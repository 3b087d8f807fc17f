// Rotary table: description, and deviations as built.
#pragma once

#include <Eigen/Geometry>

#include "fmu/model/devices/encoder.h"

namespace robotcell {

class JsonReader;

struct TableDescription {
  Eigen::Isometry3d world_from_table;  // origin at the intersection of axis and top face, z along the axis
  double radius = 0, thickness = 0;
  double max_speed = 0, max_acceleration = 0, max_jerk = 0, start = 0, friction = 0;
  bool turns = true;  // else its angle stays that at the start
  EncoderDescription encoder;
};

/// Throws DescriptionError.
TableDescription parse_table(const JsonReader& json);

/// Wobble of the table axis: at table angle t it is tilted by amplitude * cos(t + phase) about the direction
/// at the angle `direction` in the table's x-y plane.
struct TableWobble {
  double amplitude = 0, phase = 0, direction = 0;  // rad

  template <class Visitor>
  static void declare(Visitor& visit, TableWobble& w) {
    visit(w, state(w.amplitude, "amplitude"), state(w.phase, "phase"), state(w.direction, "direction"));
  }
};

}  // namespace robotcell
