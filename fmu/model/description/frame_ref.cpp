#include "fmu/model/description/frame_ref.h"

#include <string>
#include <tuple>

#include "fmu/model/description/json_reader.h"

namespace robotcell {

FrameRef parse_frame(const JsonReader& json, const FrameCounts& counts) {
  using Kind = FrameRef::Kind;
  const std::string text = json.text();
  if (text == "world") return {Kind::kWorld, 0};
  if (text == "sensor") return {Kind::kSensor, 0};
  if (text == "table") return {Kind::kTable, 0};
  for (const auto& [name, kind, count] :
       {std::tuple{"link[", Kind::kLink, counts.links}, std::tuple{"part[", Kind::kPart, counts.parts},
        std::tuple{"finger[", Kind::kFinger, counts.fingers}}) {
    for (std::size_t i = 0; i < count; ++i) {
      if (text == name + std::to_string(i + 1) + "]") return {kind, i};
    }
  }
  json.fail(
      "\"world\", \"sensor\", \"table\", \"link[i]\", \"part[i]\" or \"finger[i]\" that exists in this cell");
}

}  // namespace robotcell
