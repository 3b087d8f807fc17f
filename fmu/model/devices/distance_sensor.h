// Distance sensor: a ray along z from the origin of its frame, whose light returns to a lens.
#pragma once

#include "fmu/model/devices/sensor_mount.h"
#include "fmu/model/fields.h"

namespace robotcell {

struct DistanceSensor {
  static constexpr const char* kKey = "distance_sensors";
  static constexpr const char* kVariables = "distance";
  static constexpr const char* kName = "distance sensor";

  struct Reading {
    bool valid = false;
    double distance = 0;  // m; 0 where invalid
    double time = kNoInstant;

    template <class Visitor>
    static void declare(Visitor& visit, Reading& reading) {
      visit(
          reading,
          field(reading.valid,
                {"valid", kNone,
                 "True if the last reading of {} found a surface within its range and the return path to the "
                 "lens was free; false before the first reading"}),
          field(
              reading.distance,
              bounded({"value", kMetre,
                       "Distance along the ray at the last reading of {}, from its origin; 0 where invalid"},
                      0)),
          field(reading.time,
                instant("time", "Simulation time of the last reading of {}; 0 before the first reading")));
    }
  };

  DistanceSensor(const JsonReader& json, const SensorContext& context);
  Reading read(const SensorView& view) const;

  SensorMount mount;
  double lens_x = 0;  // m, position of the lens on the x axis
  double nearest = 0, farthest = 0;
  double noise = 0, resolution = 0;  // m; standard deviation, and step (0: not quantized)
};

}  // namespace robotcell
