#include "fmu/model/devices/belt.h"

#include <cmath>

#include "fmu/model/description/json_reader.h"
#include "fmu/model/description/value_limits.h"
#include "fmu/model/quantization.h"

namespace robotcell {

constexpr double kMaxEncoderResolution = 1;  // m

ConveyorDescription parse_conveyor(const JsonReader& json) {
  json.expect_keys({"name", "world_from_belt", "length", "width", "thickness", "max_speed",
                    "max_acceleration", "friction", "encoder_resolution"});
  ConveyorDescription conveyor;
  conveyor.name = json.at("name").text();
  conveyor.world_from_belt = json.at("world_from_belt").pose();
  conveyor.length = json.at("length").positive();
  conveyor.width = json.at("width").positive();
  conveyor.thickness = json.at("thickness").positive();
  conveyor.max_speed = json.at("max_speed").positive();
  conveyor.max_acceleration = json.at("max_acceleration").positive();
  conveyor.friction = json.at("friction").number(0, kMaxFriction);
  conveyor.encoder_resolution = json.at("encoder_resolution").number(0, kMaxEncoderResolution);
  return conveyor;
}

BeltState run_belt(const BeltState& from, double acceleration, double duration) {
  const double change = from.target - from.speed;
  const double ramp = std::abs(change) / acceleration;  // s, until the target speed is reached
  if (ramp > duration) {
    const double signed_acceleration = std::copysign(acceleration, change);
    return {from.travel + (from.speed + 0.5 * signed_acceleration * duration) * duration,
            from.speed + signed_acceleration * duration, from.target};
  }
  return {from.travel + 0.5 * (from.speed + from.target) * ramp + from.target * (duration - ramp),
          from.target, from.target};
}

BeltReading read_encoder(const BeltState& belt, const BeltErrors& errors, double resolution, double lead) {
  const double scale = 1 + errors.encoder_scale;
  const double travel = scale * (belt.travel + lead * belt.speed);
  return {quantized(travel, resolution), scale * belt.speed};
}

}  // namespace robotcell
