// Belt conveyor: description, input, outputs and state.
#pragma once

#include <Eigen/Geometry>
#include <string>

#include "fmu/model/fields.h"

namespace robotcell {

class JsonReader;

// Beyond these an encoder would read nothing, or backwards.
constexpr double kMinEncoderScale = -0.5, kMaxEncoderScale = 0.5;

struct ConveyorDescription {
  std::string name;
  Eigen::Isometry3d
      world_from_belt;  // origin in the centre of the top face, x along the motion of the belt, z up
  double length = 0, width = 0, thickness = 0;
  double max_speed = 0, max_acceleration = 0, friction = 0;
  double encoder_resolution = 0;  // m; 0: not quantized
};

/// Throws DescriptionError.
ConveyorDescription parse_conveyor(const JsonReader& json);

struct ConveyorCommand {
  double speed = 0;  // m/s

  template <class Visitor>
  static void declare(Visitor& visit, ConveyorCommand& c) {
    visit(c, field(c.speed,
                   {"speed", kMetrePerSecond,
                    "Commanded speed of the belt of {}, positive along x of the belt frame; clamped to the "
                    "maximum speed, read at the next controller cycle, approached with constant "
                    "acceleration"}));
  }
};

struct ConveyorOutputs {
  double speed = 0;           // m/s
  double travel = 0;          // m since the start
  double texture_offset = 0;  // travel modulo the belt length, m

  template <class Visitor>
  static void declare(Visitor& visit, ConveyorOutputs& o) {
    visit(
        o,
        field(o.speed, continuous({"speed", kMetrePerSecond,
                                   "Speed of the belt of {}, positive along x of the belt frame"})),
        field(o.travel,
              continuous({"travel", kMetre, "Signed distance travelled by the belt of {} since the start"})),
        field(o.texture_offset,
              bounded(continuous(
                          {"texture_offset", kMetre,
                           "Distance travelled by the belt of {} modulo the belt length: texture offset for "
                           "visualization"}),
                      0)));
  }
};

/// Reading of the encoder of a belt.
struct BeltReading {
  double travel = 0;  // m since the start
  double speed = 0;   // m/s

  template <class Visitor>
  static void declare(Visitor& visit, BeltReading& r) {
    visit(
        r,
        field(r.travel,
              continuous({"travel", kMetre,
                          "Measured signed distance travelled by the belt since the start (encoder) of {}"})),
        field(r.speed, continuous({"speed", kMetrePerSecond, "Measured speed of the belt (encoder) of {}"})));
  }
};

/// Deviations as built of all belts.
struct BeltErrors {
  double encoder_scale = 0;

  template <class Visitor>
  static void declare(Visitor& visit, BeltErrors& e) {
    visit(e,
          field(e.encoder_scale,
                bounded({"encoder_scale", kNone,
                         "Deviation as built from nominal: relative scale error of the encoders of {}. They "
                         "read the travel times 1 + encoder_scale"},
                        kMinEncoderScale, kMaxEncoderScale)));
  }
};

struct BeltState {
  double travel = 0;  // m, distance travelled since the start
  double speed = 0;   // m/s
  double target = 0;  // m/s, commanded speed

  template <class Visitor>
  static void declare(Visitor& visit, BeltState& s) {
    visit(s, state(s.travel, "travel"), state(s.speed, "speed"), command_state(s.target, "target"));
  }
};

/// State of the belt after `duration` seconds, in closed form: constant acceleration until the commanded
/// speed is reached.
BeltState run_belt(const BeltState& from, double acceleration, double duration);

/// Reading of the encoder, `lead` seconds ahead at the present speed.
BeltReading read_encoder(const BeltState& belt, const BeltErrors& errors, double resolution, double lead);

}  // namespace robotcell
