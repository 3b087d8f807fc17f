// Presence sensor: a box that detects bodies.
#pragma once

#include "fmu/model/devices/sensor_mount.h"
#include "fmu/model/fields.h"

namespace robotcell {

/// The frame of the sensor is in the centre of the box.
struct PresenceSensor {
  static constexpr const char* kKey = "presence_sensors";
  static constexpr const char* kVariables = "presence";
  static constexpr const char* kName = "presence sensor";

  struct Reading {
    bool detected = false;

    template <class Visitor>
    static void declare(Visitor& visit, Reading& reading) {
      visit(reading, field(reading.detected, {"detected", kNone,
                                              "True if any body intersected or enclosed the volume of {} at "
                                              "its last reading; false before the "
                                              "first reading"}));
    }
  };

  PresenceSensor(const JsonReader& json, const SensorContext& context);
  Reading read(const SensorView& view) const;

  SensorMount mount;
  Eigen::Vector3d size;  // m, edges of the box
};

}  // namespace robotcell
