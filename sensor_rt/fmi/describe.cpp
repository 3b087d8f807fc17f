// profile-sensor-describe: prints the model description (FMI 3) of a profile sensor ("-": read from standard
// input).
#include <cstdio>
#include <exception>
#include <string>
#include <utility>

#include "fmu/fmi/model_description.h"
#include "sensor_rt/fmi/profile_sensor.h"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: profile-sensor-describe SENSOR.json|-\n");
    return 2;
  }
  try {
    auto description = sensor_rt::parse_profile_sensor(robotcell::read_file_or_input(argv[1]));
    const std::string name = description.name;
    const double step = description.step;
    const sensor_rt::ProfileSensor sensor(std::move(description));
    const std::string xml = robotcell::fmi::model_description(
        {"ProfileSensor", "Profiles of a laser profile sensor in a robot cell: " + name, step, 0, false},
        sensor.table(), robotcell::fmi::DescriptionOptions());
    return std::fwrite(xml.data(), 1, xml.size(), stdout) == xml.size() ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", argv[1], error.what());
    return 1;
  }
}
