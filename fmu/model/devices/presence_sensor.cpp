#include "fmu/model/devices/presence_sensor.h"

#include "fmu/model/description/json_reader.h"

namespace robotcell {

PresenceSensor::PresenceSensor(const JsonReader& json, const SensorContext& context)
    : mount(parse_mount(json, context, {"x_size", "y_size", "z_size"})),
      size(json.at("x_size").length(), json.at("y_size").length(), json.at("z_size").length()) {}

PresenceSensor::Reading PresenceSensor::read(const SensorView& view) const {
  return {view.body_in_box(view.world_from_sensor(), size)};
}

}  // namespace robotcell
