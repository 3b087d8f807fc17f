// The kinds of sensors of a cell. To add one: a structure like PresenceSensor, and its name in this list.
#pragma once

#include <array>
#include <cstddef>
#include <tuple>
#include <utility>
#include <vector>

#include "fmu/model/devices/distance_sensor.h"
#include "fmu/model/devices/light_curtain.h"
#include "fmu/model/devices/presence_sensor.h"
#include "fmu/model/per_device.h"

namespace robotcell {

using SensorKinds = std::tuple<PresenceSensor, DistanceSensor, LightCurtain>;

constexpr std::size_t kSensorKinds = std::tuple_size_v<SensorKinds>;
template <std::size_t kind>
using SensorKind = std::tuple_element_t<kind, SensorKinds>;

template <class Kinds>
struct PerSensorKind;
template <class... Kind>
struct PerSensorKind<std::tuple<Kind...>> {
  using Vectors = std::tuple<std::vector<Kind>...>;
  using Readings = std::tuple<PerDevice<typename Kind::Reading>...>;
};
/// All sensors of a cell, and their readings.
using Sensors = PerSensorKind<SensorKinds>::Vectors;
using SensorReadings = PerSensorKind<SensorKinds>::Readings;

template <class Visit, std::size_t... kind>
void visit_each(const Visit& visit, std::index_sequence<kind...> /*kinds*/) {
  (visit(std::integral_constant<std::size_t, kind>()), ...);
}
/// Calls `visit` with the number of each kind as a std::integral_constant.
template <class Visit>
void for_each_sensor_kind(const Visit& visit) {
  visit_each(visit, std::make_index_sequence<kSensorKinds>());
}

template <std::size_t... kind>
SensorReadings make_readings(const std::array<std::size_t, kSensorKinds>& counts,
                             std::index_sequence<kind...> /*kinds*/) {
  return {PerDevice<typename SensorKind<kind>::Reading>(counts[kind])...};
}
/// Readings before the first one, of a number of sensors of each kind.
inline SensorReadings make_readings(const std::array<std::size_t, kSensorKinds>& counts) {
  return make_readings(counts, std::make_index_sequence<kSensorKinds>());
}

}  // namespace robotcell
