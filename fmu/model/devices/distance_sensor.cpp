#include "fmu/model/devices/distance_sensor.h"

#include <algorithm>
#include <cmath>

#include "fmu/model/description/json_reader.h"
#include "fmu/model/description/value_limits.h"
#include "fmu/model/quantization.h"

namespace robotcell {
namespace {

/// The return ray starts this far from the surface (m), to avoid hitting it again.
constexpr double kOffSurface = 1e-7;

}  // namespace

DistanceSensor::DistanceSensor(const JsonReader& json, const SensorContext& context)
    : mount(parse_mount(json, context, {"lens_x", "nearest", "farthest", "noise", "resolution"})),
      lens_x(json.at("lens_x").number(-kMaxCoordinate, kMaxCoordinate)),
      nearest(json.at("nearest").number(0, kMaxCoordinate)),
      farthest(json.at("farthest").number(nearest, kMaxCoordinate)),
      noise(json.at("noise").number(0, kMaxCoordinate)),
      resolution(json.at("resolution").number(0, kMaxCoordinate)) {}

DistanceSensor::Reading DistanceSensor::read(const SensorView& view) const {
  Reading reading;
  reading.time = view.time();
  const Eigen::Isometry3d world_from_sensor = view.world_from_sensor();
  const Eigen::Vector3d origin = world_from_sensor.translation();
  const Eigen::Vector3d direction = world_from_sensor.linear().col(2);
  const auto hit = view.cast_ray(origin, direction, 0, farthest);
  if (!hit || *hit < nearest) return reading;
  const Eigen::Vector3d hit_point = origin + *hit * direction;
  const Eigen::Vector3d to_lens = world_from_sensor * Eigen::Vector3d(lens_x, 0, 0) - hit_point;
  const double return_distance = to_lens.norm();
  if (view.cast_ray(hit_point, to_lens / return_distance, kOffSurface, return_distance)) return reading;
  double measured = *hit;
  if (noise > 0) measured += noise * view.noise();
  measured = quantized(measured, resolution);
  reading.valid = true;
  reading.distance = measured;
  return reading;
}

}  // namespace robotcell
