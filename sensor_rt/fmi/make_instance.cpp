// The instances of the FMU of a profile sensor.
#include "fmu/fmi/resource_location.h"
#include "sensor_rt/fmi/profile_sensor.h"

namespace robotcell::fmi {

std::unique_ptr<Instance> make_instance(const std::string& name, const std::string& resource_location,
                                        const Log& log, const StepOptions& options) {
  const std::string folder = resource_folder(resource_location);
  return std::make_unique<sensor_rt::ProfileSensor>(
      sensor_rt::parse_profile_sensor(read_text_file(folder + "/sensor.json")), name, log, options);
}

}  // namespace robotcell::fmi
