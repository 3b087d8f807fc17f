// What the FMU of a profile sensor reads: the sensor, the bodies that light can meet, and what moves them.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "sensor_rt/pipeline/sensor.h"
#include "sensor_rt/scene/scene.h"

namespace sensor_rt {

/// Content of the JSON description.
struct ProfileSensorDescription {
  std::string name;
  std::string frame;               ///< of the sensor, as the cell's FMU names it
  int every = 1;                   ///< exposes at every n-th trigger, from the first on
  double delay = 0;                ///< s, from the middle of the recorded exposure to that of its own
  std::optional<double> exposure;  ///< s; empty: that of the trigger record
  double step = 0;                 ///< s, communication step that importers get as the default
  Sensor sensor;                   ///< which interprets what is seen
  std::optional<Sensor> as_built;  ///< the true sensor; empty: the same
  Scene scene;
  std::vector<std::string> frames;  ///< that carry the bodies of the scene; empty: at rest in the world
};

/// Throws std::exception that names the key, its value and what was expected.
ProfileSensorDescription parse_profile_sensor(const std::string& json);

}  // namespace sensor_rt
