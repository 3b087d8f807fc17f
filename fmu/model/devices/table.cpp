#include "fmu/model/devices/table.h"

#include "fmu/model/description/json_reader.h"
#include "fmu/model/description/value_limits.h"

namespace robotcell {

TableDescription parse_table(const JsonReader& json) {
  json.expect_keys({"world_from_table", "radius", "thickness", "max_speed", "max_acceleration", "max_jerk",
                    "start", "friction", "encoder_resolution", "encoder_noise", "encoder_latency"},
                   {"moves_with", "turns"});
  TableDescription table;
  table.world_from_table = json.at("world_from_table").pose();
  table.radius = json.at("radius").positive();
  table.thickness = json.at("thickness").positive();
  table.max_speed = json.at("max_speed").positive();
  table.max_acceleration = json.at("max_acceleration").positive();
  table.max_jerk = json.at("max_jerk").positive();
  table.start = json.at("start").number();
  table.friction = json.at("friction").number(0, kMaxFriction);
  if (json.has("turns")) table.turns = json.at("turns").boolean();
  table.encoder = parse_encoder(json);
  return table;
}

}  // namespace robotcell
