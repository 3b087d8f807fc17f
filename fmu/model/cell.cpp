#include "fmu/model/cell.h"

#include <algorithm>
#include <limits>
#include <stdexcept>

namespace robotcell {
namespace {

constexpr double kSecondsPerTick = 1e-6;
static_assert(kAxes == control::kAxes, "the controller moves the arm's joints and the table");

std::array<control::AxisLimits, kAxes> axis_limits(const CellDescription& cell) {
  std::array<control::AxisLimits, kAxes> limits;
  for (std::size_t i = 0; i < kJoints; ++i) {
    const JointDescription& joint = cell.joints[i];
    limits[i] = {joint.min, joint.max, joint.max_speed, joint.max_acceleration};
  }
  constexpr double kEndless = std::numeric_limits<double>::infinity();
  limits[kTableAxis] = {-kEndless, kEndless, cell.table.max_speed, cell.table.max_acceleration};
  return limits;
}

AxesState start_of(const CellDescription& cell) {
  AxesState start;
  for (std::size_t i = 0; i < kJoints; ++i) start.position[i] = cell.joints[i].start;
  start.position[kTableAxis] = cell.table.start;
  return start;
}

/// Cubic through the positions and rates of two states, at share s of the time between them.
AxesState interpolated(const AxesState& from, const AxesState& to, double duration, double s) {
  AxesState state;
  for (std::size_t i = 0; i < kAxes; ++i) {
    const auto knot =
        control::cubic_between({from.position[i], from.rate[i]}, {to.position[i], to.rate[i]}, duration, s);
    state.position[i] = knot.position;
    state.rate[i] = knot.velocity;
  }
  return state;
}

}  // namespace

Cell::Cell(const CellDescription& description, const CellParameters& parameters)
    : description_(description),
      nominal_(description, AsBuilt{}),
      true_(description, parameters.as_built),
      encoders_(description, parameters.seed),
      servo_(axis_limits(description), description.controller_cycle_us, start_of(description).position),
      world_(description, true_, start_of(description)),
      trigger_(parameters.as_built.trigger_latency) {
  if (parameters.as_built.trigger_latency < 0) {
    throw std::invalid_argument("as_built.trigger.latency must not be negative");
  }
  to_.axes = start_of(description);
  place_part(to_);
  from_ = to_;
}

void Cell::place_part(GridPoint& point) const {
  const Eigen::Isometry3d pose = world_.platter_from_part();
  point.part_position = pose.translation();
  point.part_orientation = Eigen::Quaterniond(pose.linear());
}

void Cell::begin_step(const CellInputs& inputs) {
  if (inputs.mode != 0 && inputs.mode != 1) {
    throw std::invalid_argument("command.mode must be 0 (hold) or 1 (servo)");
  }
  if (inputs.trigger.mode < 0 || inputs.trigger.mode > static_cast<std::int32_t>(TriggerMode::kRequest)) {
    throw std::invalid_argument("command.trigger.mode must be from 0 to 4");
  }
  trigger_.command(inputs, time_us_, *this);
}

std::int64_t Cell::run(const CellInputs& inputs, std::int64_t to_us, bool until_record) {
  while (time_us_ < to_us) {
    if (time_us_ == to_.time_us) step_dynamics(inputs);
    std::int64_t until = std::min(to_us, to_.time_us);
    bool ready = false;
    if (until_record) {
      // Look ahead on a copy: what would fire behind the stop must not have fired yet.
      Trigger ahead = trigger_;
      ahead.watch(time_us_, until, false, *this);
      const std::int64_t next = std::max(ahead.next_ready(), time_us_ + 1);
      ready = next <= until;
      until = std::min(until, next);
    }
    trigger_.watch(time_us_, until, until == to_.time_us, *this);
    trigger_.latch(until, *this);
    time_us_ = until;
    if (ready) break;
  }
  return time_us_;
}

void Cell::step_dynamics(const CellInputs& inputs) {
  if (to_.time_us % description_.controller_cycle_us == 0) {
    servo_.cycle(to_.time_us, {inputs.mode == 1, inputs.position});
  }
  from_ = to_;
  to_.time_us += description_.time_step_us;
  const control::Knots knots = servo_.sample(to_.time_us);
  for (std::size_t i = 0; i < kAxes; ++i) {
    to_.axes.position[i] = knots[i].position;
    to_.axes.rate[i] = knots[i].velocity;
  }
  world_.step(from_.axes, to_.axes);
  if (description_.part.free) place_part(to_);
}

AxesState Cell::axes_at(std::int64_t time_us) const {
  if (time_us == to_.time_us) return to_.axes;
  if (time_us == from_.time_us) return from_.axes;
  const auto span = static_cast<double>(to_.time_us - from_.time_us);
  return interpolated(from_.axes, to_.axes, span * kSecondsPerTick,
                      static_cast<double>(time_us - from_.time_us) / span);
}

double Cell::table_angle(std::int64_t time_us) const { return axes_at(time_us).position[kTableAxis]; }

Eigen::Vector3d Cell::sensor_in_table(std::int64_t time_us) const {
  const AxesState axes = axes_at(time_us);
  const Motion sensor = nominal_.sensor(nominal_.arm(axes.position, axes.rate).back());
  const Motion platter = nominal_.platter(axes.position[kTableAxis], 0);
  return platter.pose.inverse() * sensor.pose.translation();
}

Measurement Cell::measurement(std::int64_t time_us) const {
  const AxesState axes = axes_at(time_us);
  return {encoders_.read(axes.position, time_us), axes.rate};
}

/// The part moves with the platter, and between two grid points evenly relative to it.
Motion Cell::part_at(std::int64_t time_us, const Motion& platter) const {
  Eigen::Isometry3d platter_from_part;
  const auto span = static_cast<double>(to_.time_us - from_.time_us);
  const double s = span > 0 ? static_cast<double>(time_us - from_.time_us) / span : 1;
  const Eigen::Quaterniond turn = from_.part_orientation.conjugate() * to_.part_orientation;
  const Eigen::Vector3d travel = to_.part_position - from_.part_position;
  platter_from_part = Eigen::Translation3d(from_.part_position + s * travel) *
                      from_.part_orientation.slerp(s, to_.part_orientation);
  Motion part = attached(platter, platter_from_part);
  if (span > 0 && description_.part.free) {
    const Eigen::AngleAxisd rotation(turn);
    const double rate = 1 / (span * kSecondsPerTick);
    part.velocity += platter.pose.linear() * travel * rate;
    part.angular_velocity += part.pose.linear() * rotation.axis() * (rotation.angle() * rate);
  }
  return part;
}

Bodies Cell::truth(std::int64_t time_us) const {
  const AxesState axes = axes_at(time_us);
  Bodies bodies;
  const auto links = true_.arm(axes.position, axes.rate);
  for (std::size_t i = 0; i < kJoints; ++i) bodies[i] = body_state(links[i]);
  bodies[kSensor] = body_state(true_.sensor(links.back()));
  const Motion platter = true_.platter(axes.position[kTableAxis], axes.rate[kTableAxis]);
  bodies[kTable] = body_state(platter);
  bodies[kPart] = body_state(part_at(time_us, platter));
  return bodies;
}

CellOutputs Cell::outputs() const {
  CellOutputs outputs;
  outputs.measured = measurement(time_us_);
  outputs.truth = {axes_at(time_us_).position, truth(time_us_)};
  outputs.trigger_count = trigger_.count();
  outputs.trigger_queued = trigger_.queued();
  outputs.trigger = trigger_.shown();
  outputs.moving = servo_.moving(time_us_);
  outputs.limit = servo_.state().limit;
  return outputs;
}

CellState Cell::state() const {
  return {time_us_, from_, to_, servo_.state(), world_.free_part(), trigger_.state()};
}

void Cell::restore(const CellState& state) {
  time_us_ = state.time_us;
  from_ = state.from;
  to_ = state.to;
  servo_.restore(state.servo);
  world_.restore(state.to.axes, state.part);
  trigger_.restore(state.trigger);
}

}  // namespace robotcell
