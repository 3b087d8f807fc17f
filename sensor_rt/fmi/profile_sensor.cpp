#include "sensor_rt/fmi/profile_sensor.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "fmu/fmi/sealed_state.h"
#include "fmu/fmi/table_builder.h"
#include "sensor_rt/pipeline/scan.h"

namespace sensor_rt {

using namespace robotcell;
using namespace robotcell::fmi;

namespace {

constexpr std::array<const char*, 4> kQuaternionNames{"w", "x", "y", "z"};
constexpr std::size_t kAtRest = std::numeric_limits<std::size_t>::max();
constexpr double kShortest = 1e-9, kLongest = 10.0;  // s, of an exposure
constexpr double kUnitNorm = 1e-6;                   // of a quaternion, by which its norm may deviate from 1

/// Frames that carry bodies, each once, behind that of the sensor.
std::vector<std::string> frame_names(const ProfileSensorDescription& description) {
  std::vector<std::string> names{description.frame};
  for (const std::string& frame : description.frames) {
    const bool known = std::find(names.begin(), names.end(), frame) != names.end();
    if (!frame.empty() && !known) names.push_back(frame);
  }
  return names;
}

const Sensor& true_sensor(const ProfileSensorDescription& description) {
  return description.as_built ? *description.as_built : description.sensor;
}

/// Pose of a body some time after the middle of the exposure, s.
Rigid3 pose_after(const BodyState& body, double time) {
  const Eigen::Vector3d turn = time * Eigen::Map<const Eigen::Vector3d>(body.angular_velocity.data());
  const double angle = turn.norm();
  Rigid3 pose;
  pose.rotation =
      Eigen::Quaterniond(body.orientation[0], body.orientation[1], body.orientation[2], body.orientation[3])
          .normalized()
          .toRotationMatrix();
  if (angle > 0) pose.rotation = Eigen::AngleAxisd(angle, turn / angle) * pose.rotation;
  pose.translation = Eigen::Map<const Eigen::Vector3d>(body.position.data()) +
                     time * Eigen::Map<const Eigen::Vector3d>(body.velocity.data());
  return pose;
}

}  // namespace

ProfileSensor::ProfileSensor(ProfileSensorDescription description, const std::string& name, const Log& log,
                             const StepOptions& options)
    : TableInstance(name, log, options),
      description_(std::move(description)),
      frames_(frame_names(description_)),
      worker_(true_sensor(description_), description_.sensor, !description_.scene.lights().empty()) {
  if (options.event_mode) throw std::invalid_argument("this FMU has no event mode");
  check_engine(description_.sensor, Engine::kGeometric);
  check_engine(true_sensor(description_), Engine::kGeometric);
  for (const std::string& frame : description_.frames) {
    const auto found = std::find(frames_.begin(), frames_.end(), frame);
    frame_of_body_.push_back(frame.empty() ? kAtRest : static_cast<std::size_t>(found - frames_.begin()));
  }
  values_.frames.resize(frames_.size());
  const std::size_t most =
      description_.sensor.cameras.size() * static_cast<std::size_t>(description_.sensor.geometric_rays);
  for (auto* array : {&values_.x, &values_.y, &values_.z, &values_.intensity}) array->resize(most);
  for (auto* array : {&values_.flags, &values_.camera, &values_.column}) array->resize(most);
  clear();
  set_table(VariableTable(variables()));
}

std::vector<Variable> ProfileSensor::variables() {
  TableBuilder table(CellLayout{});
  const auto discrete = Variability::kDiscrete;
  const auto input = Causality::kInput;
  table.add("time", Causality::kIndependent, Variability::kContinuous, kSecond, "Simulation time",
            values_.time);
  table.add("laser.enabled", input, discrete, kNone, "Whether the laser shines during exposures",
            values_.enabled);
  table.add("trigger.index", input, discrete, kNone,
            "Index of the trigger record; a change is an exposure. 0: none", values_.trigger);
  table.bound(0);
  table.add("trigger.time", input, discrete, kSecond, "Middle of the exposure", values_.trigger_time);
  table.add("trigger.exposure", input, discrete, kSecond, "Duration of the exposure", values_.exposure);
  table.bound(0, kLongest);
  for (std::size_t f = 0; f < frames_.size(); ++f) {
    BodyState& body = values_.frames[f];
    const auto add = [&](const char* part, Unit unit, const std::string& text, double* value,
                         std::size_t count) {
      const char* const* axes = count == 4 ? kQuaternionNames.data() : kAxisNames.data();
      for (std::size_t i = 0; i < count; ++i) {
        table.add(indexed("trigger.truth." + frames_[f] + "." + part, i), input, discrete, unit,
                  text + " " + axes[i] + " of " + frames_[f] + " in the middle of the exposure", value[i]);
      }
    };
    add("position", kMetre, "Position", body.position.data(), 3);
    add("orientation", kNone, "Quaternion", body.orientation.data(), 4);
    add("velocity", kMetrePerSecond, "Velocity", body.velocity.data(), 3);
    add("angular_velocity", kRadianPerSecond, "Angular velocity", body.angular_velocity.data(), 3);
  }
  const auto output = Causality::kOutput;
  table.add("laser.on", output, discrete, kNone, "True if the laser has shone in the last step",
            values_.laser_on);
  table.add("profile.index", output, discrete, kNone,
            "Index of the trigger record of the present profile; 0: none", values_.index);
  table.add("profile.time", output, discrete, kSecond, "Middle of its exposure", values_.profile_time);
  table.add("profile.count", output, discrete, kNone,
            "Number of its points, which come first in the arrays; the other elements are 0", values_.count);
  const auto size = static_cast<std::uint32_t>(values_.x.size());
  const auto add_array = [&](const char* name, Unit unit, const std::string& text, auto& values) {
    table.add(name, output, discrete, unit, text, values.front());
    table.make_array({size});
  };
  add_array("profile.x", kMetre, "Points of the profile, across the laser sheet, in the frame of the sensor",
            values_.x);
  add_array("profile.y", kMetre, "Points of the profile, along the laser line", values_.y);
  add_array("profile.z", kMetre, "Points of the profile, distance from the laser", values_.z);
  add_array("profile.intensity", kNone, "Height of the stripe at each point, digital numbers",
            values_.intensity);
  add_array("profile.flags", kNone, "Flags of each point: 1 the stripe saturates", values_.flags);
  add_array("profile.camera", kNone, "Camera that sees each point, from 0", values_.camera);
  add_array("profile.column", kNone, "Column of the image in which each point is", values_.column);
  return table.take();
}

void ProfileSensor::clear() {
  values_.enabled = true;
  values_.laser_on = false;
  values_.trigger = values_.index = values_.count = 0;
  values_.trigger_time = values_.profile_time = 0;
  values_.exposure = description_.exposure.value_or(true_sensor(description_).detector.exposure);
  std::fill(values_.frames.begin(), values_.frames.end(), BodyState());
  for (auto* array : {&values_.x, &values_.y, &values_.z, &values_.intensity}) {
    std::fill(array->begin(), array->end(), 0.0);
  }
  for (auto* array : {&values_.flags, &values_.camera, &values_.column}) {
    std::fill(array->begin(), array->end(), 0);
  }
  memory_ = 0;
}

void ProfileSensor::check_restored() const {
  if (values_.count < 0 || static_cast<std::size_t>(values_.count) > values_.x.size()) reject_value();
}

StepResult ProfileSensor::do_step(double current, double step) {
  const std::int64_t planned = begin_step(current, step);
  const auto last = static_cast<std::int32_t>(memory_);  // record that the step before has seen
  const bool exposes =
      values_.trigger != last && values_.trigger > 0 && (values_.trigger - 1) % description_.every == 0;
  if (exposes) expose();
  values_.laser_on = exposes && values_.enabled;
  memory_ = values_.trigger;
  end_step(current, step, planned);
  return {};
}

Exposures ProfileSensor::exposures() const {
  Exposures result;
  result.count = 1;
  result.samples = 2;
  result.bodies = frame_of_body_.size();
  const double duration = description_.exposure.value_or(values_.exposure);
  if (!(duration >= kShortest)) {
    throw std::invalid_argument("trigger.exposure is " + std::to_string(duration) +
                                " s, expected a positive duration");
  }
  const auto ends = [&](const BodyState& body, std::vector<Rigid3>& poses) {
    for (const double end : {-0.5, 0.5}) {
      poses.push_back(pose_after(body, description_.delay + end * duration));
    }
  };
  for (std::size_t f = 0; f < frames_.size(); ++f) {
    const auto& q = values_.frames[f].orientation;
    const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (std::abs(norm - 1) <= kUnitNorm) continue;
    throw std::invalid_argument("trigger.truth." + frames_[f] + ".orientation has the norm " +
                                std::to_string(norm) + ", expected a unit quaternion w, x, y, z");
  }
  ends(values_.frames.front(), result.world_from_sensor);
  for (const std::size_t frame : frame_of_body_) {
    ends(frame == kAtRest ? BodyState() : values_.frames[frame], result.world_from_body);
  }
  result.duration = {duration};
  result.index = {values_.trigger};
  return result;
}

void ProfileSensor::expose() {
  Profiles profile;
  if (values_.enabled) worker_.run(description_.scene, exposures(), 0, profile);
  const std::size_t count = profile.size();
  const auto fill = [count](auto& to, const auto& of) {
    for (std::size_t i = 0; i < count; ++i) to[i] = of(i);
    std::fill(to.begin() + static_cast<std::ptrdiff_t>(count), to.end(), 0);
  };
  fill(values_.x, [&](std::size_t i) { return profile.points_in_sensor[i].x(); });
  fill(values_.y, [&](std::size_t i) { return profile.points_in_sensor[i].y(); });
  fill(values_.z, [&](std::size_t i) { return profile.points_in_sensor[i].z(); });
  fill(values_.intensity, [&](std::size_t i) { return static_cast<double>(profile.intensity[i]); });
  fill(values_.flags, [&](std::size_t i) { return static_cast<std::int32_t>(profile.flags[i]); });
  fill(values_.camera, [&](std::size_t i) { return profile.camera[i]; });
  fill(values_.column, [&](std::size_t i) { return profile.column[i]; });
  values_.index = values_.trigger;
  values_.profile_time = values_.trigger_time;
  values_.count = static_cast<std::int32_t>(count);
}

}  // namespace sensor_rt
