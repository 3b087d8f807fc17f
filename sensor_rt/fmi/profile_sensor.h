// Profile sensor: an FMU that takes the poses in the trigger records of a cell's FMU, and gives the profile
// that the geometric engine sees.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "fmu/fmi/table_instance.h"
#include "fmu/model/bodies.h"
#include "sensor_rt/fmi/profile_sensor_description.h"
#include "sensor_rt/pipeline/geometric_worker.h"

namespace sensor_rt {

class ProfileSensor : public robotcell::fmi::TableInstance {
 public:
  explicit ProfileSensor(ProfileSensorDescription description, const std::string& name = "sensor",
                         const robotcell::fmi::Log& log = robotcell::fmi::Log({}, false),
                         const robotcell::fmi::StepOptions& options = {});

  /// A change of trigger.index is an exposure: the profile is that of the record in the inputs at the begin
  /// of the step, and an output at its end.
  robotcell::fmi::StepResult do_step(double current, double step) override;

 private:
  struct Values {
    double time = 0;  // s
    bool enabled = true;
    std::int32_t trigger = 0;                  // index of the record
    double trigger_time = 0;                   // s
    double exposure = 0;                       // s
    std::vector<robotcell::BodyState> frames;  // of the record: of the sensor, then what carries bodies
    bool laser_on = false;
    std::int32_t index = 0, count = 0;  // of the profile
    double profile_time = 0;            // s
    std::vector<double> x, y, z, intensity;
    std::vector<std::int32_t> flags, camera, column;
  };

  void start() override {}
  void clear() override;
  void check_restored() const override;
  void before_get(const robotcell::fmi::Variable& /*variable*/) override {
    values_.time = communication_time_;
  }
  std::vector<robotcell::fmi::Variable> variables();
  /// Computes the profile of the record in the inputs.
  void expose();
  Exposures exposures() const;

  ProfileSensorDescription description_;
  std::vector<std::string> frames_;         // names, of the sensor first
  std::vector<std::size_t> frame_of_body_;  // number of the frame that carries a body; kAtRest: none
  GeometricWorker worker_;
  Values values_;
};

}  // namespace sensor_rt
