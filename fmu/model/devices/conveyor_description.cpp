#include "fmu/model/devices/conveyor_description.h"

#include "fmu/model/description/json_reader.h"
#include "fmu/model/description/value_limits.h"

namespace robotcell {

ConveyorDescription parse_conveyor(const JsonReader& json) {
  json.expect_keys({"name", "world_from_belt", "length", "width", "thickness", "max_speed",
                    "max_acceleration", "friction"});
  ConveyorDescription conveyor;
  conveyor.name = json.at("name").text();
  conveyor.world_from_belt = json.at("world_from_belt").pose();
  conveyor.length = json.at("length").positive();
  conveyor.width = json.at("width").positive();
  conveyor.thickness = json.at("thickness").positive();
  conveyor.max_speed = json.at("max_speed").positive();
  conveyor.max_acceleration = json.at("max_acceleration").positive();
  conveyor.friction = json.at("friction").number(0, kMaxFriction);
  return conveyor;
}

}  // namespace robotcell
