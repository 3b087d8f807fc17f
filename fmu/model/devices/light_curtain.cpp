#include "fmu/model/devices/light_curtain.h"

#include <cmath>

#include "fmu/model/description/json_reader.h"

namespace robotcell {
namespace {

constexpr int kMaxBeams = 1000;
constexpr double kSpacingTolerance = 1e-9;  // of the number of spacings in the height

}  // namespace

LightCurtain::LightCurtain(const JsonReader& json, const SensorContext& context)
    : mount(parse_mount(json, context, {"width", "height", "beam_spacing"})),
      width(json.at("width").length()),
      beam_spacing(json.at("beam_spacing").length()) {
  const double spacings = json.at("height").length() / beam_spacing;
  if (spacings >= kMaxBeams) json.at("beam_spacing").fail("at most 1000 beams over the height");
  beams = 1 + static_cast<int>(std::floor(spacings + kSpacingTolerance));
}

LightCurtain::Reading LightCurtain::read(const SensorView& view) const {
  const Eigen::Isometry3d world_from_sensor = view.world_from_sensor();
  Reading reading;
  for (int i = 0; i < beams; ++i) {
    const Eigen::Vector3d origin = world_from_sensor * Eigen::Vector3d(i * beam_spacing, 0, 0);
    if (view.cast_ray(origin, world_from_sensor.linear().col(2), 0, width)) ++reading.beams;
  }
  reading.interrupted = reading.beams > 0;
  return reading;
}

}  // namespace robotcell
