#include "fmu/model/description/frame_numbers.h"

#include <string>
#include <tuple>

#include "fmu/model/description/json_reader.h"

namespace robotcell {

std::size_t FrameNumbers::parse(const JsonReader& json) const {
  const std::string text = json.text();
  if (text == "world") return kWorld;
  if (text == "sensor") return sensor();
  if (text == "table") return platter();
  using Numbers = FrameNumbers;
  for (const auto& [name, number, count] :
       {std::tuple{"axis[", &Numbers::axis, axes}, std::tuple{"link[", &Numbers::link, joints},
        std::tuple{"conveyor[", &Numbers::conveyor, conveyors},
        std::tuple{"finger[", &Numbers::finger, fingers}, std::tuple{"part[", &Numbers::part, parts}}) {
    for (std::size_t i = 0; i < count; ++i) {
      if (text == name + std::to_string(i + 1) + "]") return (this->*number)(i);
    }
  }
  for (std::size_t i = 0; i < further_sensors; ++i) {
    if (text == "sensor[" + std::to_string(i + 2) + "]") return further_sensor(i);
  }
  json.fail(
      "\"world\", \"sensor\", \"sensor[i]\", \"table\", \"axis[i]\", \"link[i]\", \"conveyor[i]\", "
      "\"finger[i]\" or "
      "\"part[i]\" "
      "that is possible here");
}

}  // namespace robotcell
