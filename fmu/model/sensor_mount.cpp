#include "fmu/model/sensor_mount.h"

#include <tuple>

#include "fmu/model/json_reader.h"

namespace robotcell {
namespace {

constexpr std::int64_t kMaxPeriodUs = 1000000;
constexpr std::size_t kLinks = 6;

}  // namespace

FrameRef parse_frame(const JsonReader& json, const SensorContext& context) {
  using Kind = FrameRef::Kind;
  const std::string text = json.text();
  if (text == "world") return {Kind::kWorld, 0};
  if (text == "sensor") return {Kind::kSensor, 0};
  if (text == "table") return {Kind::kTable, 0};
  for (const auto& [name, kind, count] :
       {std::tuple{"link[", Kind::kLink, kLinks}, std::tuple{"part[", Kind::kPart, context.parts},
        std::tuple{"finger[", Kind::kFinger, context.fingers}}) {
    for (std::size_t i = 0; i < count; ++i) {
      if (text == name + std::to_string(i + 1) + "]") return {kind, i};
    }
  }
  json.fail(
      "\"world\", \"sensor\", \"table\", \"link[i]\", \"part[i]\" or \"finger[i]\" that exists in this cell");
}

SensorMount parse_mount(const JsonReader& json, const SensorContext& context,
                        const std::vector<const char*>& other_keys) {
  std::vector<const char*> keys{"name", "frame", "frame_from_sensor", "period_us"};
  keys.insert(keys.end(), other_keys.begin(), other_keys.end());
  json.expect_keys(keys);
  SensorMount mount;
  mount.name = json.at("name").text();
  mount.frame = parse_frame(json.at("frame"), context);
  mount.frame_from_sensor = json.at("frame_from_sensor").pose();
  mount.period_us = json.at("period_us").integer(1, kMaxPeriodUs);
  if (mount.period_us % context.time_step_us != 0) json.at("period_us").fail("a multiple of time_step_us");
  return mount;
}

}  // namespace robotcell
