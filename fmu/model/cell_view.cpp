// Outputs of the cell at any instant of a dynamics step.
#include <algorithm>
#include <cmath>

#include "fmu/control/time_units.h"
#include "fmu/model/cell.h"

namespace robotcell {

double Cell::step_fraction(std::int64_t time_us) const {
  const auto span = static_cast<double>(to_.time_us - from_.time_us);
  return span > 0 ? static_cast<double>(time_us - from_.time_us) / span : 1;
}

double Cell::step_duration() const {
  return static_cast<double>(to_.time_us - from_.time_us) * kSecondsPerMicrosecond;
}

AxesState Cell::true_axes_at(std::int64_t time_us) const {
  return interpolate({from_.time_us, from_.true_axes}, {to_.time_us, to_.true_axes}, time_us);
}

AxesState Cell::encoders_at(std::int64_t time_us) const {
  return interpolate({from_.time_us, from_.encoders}, {to_.time_us, to_.encoders}, time_us);
}

BeltState Cell::belt_at(std::size_t belt, std::int64_t time_us) const {
  return run_belt(from_.prescribed.belts[belt], description_.conveyors[belt].max_acceleration,
                  static_cast<double>(time_us - from_.time_us) * kSecondsPerMicrosecond);
}

BeltReading Cell::belt_reading(std::size_t belt, std::int64_t time_us, double lead) const {
  return read_encoder(belt_at(belt, time_us), belt_errors_, description_.conveyors[belt].encoder_resolution,
                      lead);
}

control::Knot Cell::table(std::int64_t time_us) const {
  const AxesState axes = encoders_at(time_us);
  return {axes.position[kTableAxis], axes.rate[kTableAxis]};
}

control::RunningSegment Cell::running_segment(std::int64_t time_us) const {
  return controller_.running_segment(time_us);
}

SensorOnSupport Cell::sensor_on_support(std::int64_t time_us) const {
  const AxesState axes = encoders_at(time_us);
  const FrameNumbers& numbers = nominal_.numbers();
  const bool held = description_.parts.front().stands_on == numbers.flange();
  const Motion sensor = nominal_.frame(numbers.sensor(), axes.position, axes.rate);
  const Motion support =
      nominal_.frame(held ? numbers.flange() : numbers.platter(), axes.position, axes.rate);
  const Eigen::Vector3d from_centre = sensor.pose.translation() - support.pose.translation();
  const Eigen::Vector3d of_support = support.velocity + support.angular_velocity.cross(from_centre);
  return {support.pose.inverse() * sensor.pose.translation(), (sensor.velocity - of_support).norm()};
}

Measurement Cell::measurement(std::int64_t time_us) const {
  Measurement reading{encoders_at(time_us).position, encoders_at(time_us).rate};
  for (std::size_t i = 0; i < kAxes; ++i) {
    if (encoders_.latency_us(i) == 0) continue;
    const std::int64_t sample_us = std::max<std::int64_t>(0, time_us - encoders_.latency_us(i));
    const AxesState axes = sample_us >= from_.time_us ? encoders_at(sample_us) : history_.at(sample_us);
    reading.position[i] = axes.position[i];
    reading.rate[i] = axes.rate[i];
  }
  reading.position = encoders_.read(reading.position, time_us);
  return reading;
}

/// A finger slides on the flange, with constant velocity between two grid points.
Motion Cell::finger_at(std::size_t finger, std::int64_t time_us, const Motion& flange) const {
  const double from = from_.gripper.opening[finger];
  const double travel = to_.gripper.opening[finger] - from;
  const double opening = from + step_fraction(time_us) * travel;
  Motion motion = attached(flange, description_.gripper->flange_from_finger(finger, opening));
  const double duration = step_duration();
  if (duration > 0) motion.velocity += motion.pose.linear().col(0) * (travel / duration);
  return motion;
}

/// A part moves with the frame that carries it, and relative to it with constant velocity between two grid
/// points. A residual displacement decays.
Motion Cell::part_at(std::size_t part, std::int64_t time_us, const Motion& carrier) const {
  const PartPose& from = from_.parts[part];
  const PartPose& to = to_.parts[part];
  const double s = step_fraction(time_us);
  const Eigen::Quaterniond relative_rotation = from.orientation.conjugate() * to.orientation;
  const Eigen::Vector3d travel = to.position - from.position;
  Motion motion = attached(
      carrier, Eigen::Translation3d(from.position + s * travel) * from.orientation.slerp(s, to.orientation));
  const double duration = step_duration();
  if (!from.residual_displacement.isZero(0)) {
    const Eigen::Vector3d residual = residual_share(s * duration) * from.residual_displacement;
    motion.pose.pretranslate(residual);
    motion.velocity -= residual / kResidualDecayTime;
  }
  if (duration > 0 && description_.parts[part].free) {
    const Eigen::AngleAxisd rotation(relative_rotation);
    const double rate = 1 / duration;
    motion.velocity += carrier.pose.linear() * travel * rate;
    motion.angular_velocity += motion.pose.linear() * rotation.axis() * (rotation.angle() * rate);
  }
  return motion;
}

std::vector<Motion> Cell::frames_at(std::int64_t time_us) const {
  const AxesState axes = true_axes_at(time_us);
  std::vector<Motion> frames = true_.motions(axes.position, axes.rate, vibration_.at(time_us));
  const std::size_t flange = true_.numbers().flange();
  for (std::size_t i = 0; i < true_.numbers().fingers; ++i) {
    frames.push_back(finger_at(i, time_us, frames[flange]));
  }
  for (std::size_t i = 0; i < to_.parts.size(); ++i) {
    frames.push_back(part_at(i, time_us, frames[to_.parts[i].frame]));
  }
  return frames;
}

void Cell::write_truth(std::int64_t time_us, Bodies& bodies) const {
  const std::vector<Motion> frames = frames_at(time_us);
  const FrameNumbers& numbers = true_.numbers();
  const auto state = [&frames](std::size_t frame) { return body_state(frames[frame]); };
  for (std::size_t i = 0; i < numbers.axes; ++i) bodies.axes[i] = state(numbers.axis(i));
  for (std::size_t i = 0; i < numbers.joints; ++i) bodies.links[i] = state(numbers.link(i));
  bodies.sensor = state(numbers.sensor());
  bodies.table = state(numbers.platter());
  for (std::size_t i = 0; i < numbers.parts; ++i) bodies.parts[i] = state(numbers.part(i));
  for (std::size_t i = 0; i < numbers.fingers; ++i) bodies.fingers[i] = state(numbers.finger(i));
  for (std::size_t i = 0; i < numbers.further_sensors; ++i) {
    bodies.further_sensors[i] = state(numbers.further_sensor(i));
  }
}

/// Status of the controller, with the error of the trigger where it has none of its own.
control::Report Cell::report() const {
  control::Report report = controller_.report(time_us_);
  if (report.error == control::ControllerError::kNone) report.error = trigger_.error();
  return report;
}

std::string Cell::refusal() const {
  const control::Report report = this->report();
  if (report.error == control::ControllerError::kNone) return "";
  const ControllerOutputs outputs = outputs_of(report, description_.joints.size(), start_time_);
  std::string text = enumeration_of<control::ControllerError>.items[outputs.error].text;
  if (report.error == control::ControllerError::kNoSegment) return text + ": " + program_.fault;
  if (outputs.limit != 0) text += ": axis " + std::to_string(outputs.limit);
  return text;
}

void Cell::write_outputs(CellOutputs& outputs) const {
  outputs.measured = measurement(time_us_);
  outputs.truth.position = true_axes_at(time_us_).position;
  write_truth(time_us_, outputs.truth.bodies);
  outputs.trigger_count = trigger_.count();
  outputs.trigger_queued = trigger_.queued();
  outputs.trigger = trigger_.current_record();
  const control::Report report = this->report();
  outputs.controller = outputs_of(report, description_.joints.size(), start_time_);
  outputs.pendant = pendant_of(report, refusal(), pendant_);
  outputs.gripper = gripper_outputs();
  if (description_.dynamics) {
    const ArmDynamicsState arm = world_.arm();
    for (std::size_t i = 0; i < kMaxJoints; ++i) outputs.motor_torque[i] = arm.motors[i].torque;
  }
  for (std::size_t i = 0; i < outputs.conveyors.size(); ++i) {
    const BeltState belt = belt_at(i, time_us_);
    const double length = description_.conveyors[i].length;
    const double laps = std::floor(belt.travel / length);
    outputs.conveyors[i] = {belt.speed, belt.travel, belt.travel - laps * length};
    outputs.belt_readings[i] = belt_reading(i, time_us_, 0);
  }
  outputs.readings = readings();
  outputs.solver_fallbacks = solver_fallbacks();
  outputs.truncated_contacts = truncated_contacts();
}

/// Forces are those of the current dynamics step.
GripperOutputs Cell::gripper_outputs() const {
  const double s = step_fraction(time_us_);
  GripperOutputs outputs = to_.gripper.outputs;
  for (std::size_t i = 0; i < 2; ++i) {
    const double from = from_.gripper.opening[i];
    outputs.width += from + s * (to_.gripper.opening[i] - from);
  }
  return outputs;
}

}  // namespace robotcell
