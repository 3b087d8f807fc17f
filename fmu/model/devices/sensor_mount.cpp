#include "fmu/model/devices/sensor_mount.h"

#include "fmu/model/description/json_reader.h"

namespace robotcell {
namespace {

constexpr std::int64_t kMaxPeriodUs = 1000000;

}  // namespace

SensorMount parse_mount(const JsonReader& json, const SensorContext& context,
                        const std::vector<const char*>& other_keys) {
  std::vector<const char*> keys{"name", "frame", "frame_from_sensor", "period_us"};
  keys.insert(keys.end(), other_keys.begin(), other_keys.end());
  json.expect_keys(keys);
  SensorMount mount;
  mount.name = json.at("name").text();
  mount.frame = context.frames.parse(json.at("frame"));
  mount.frame_from_sensor = json.at("frame_from_sensor").pose();
  mount.period_us = json.at("period_us").integer(1, kMaxPeriodUs);
  if (mount.period_us % context.time_step_us != 0) json.at("period_us").fail("a multiple of time_step_us");
  return mount;
}

}  // namespace robotcell
