#include "fmu/model/cell.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "fmu/control/time_units.h"
#include "fmu/model/description/program_file.h"
#include "fmu/model/random.h"

namespace robotcell {
namespace {

constexpr std::uint64_t kTriggerKey = 0x7472696767657200;

PrescribedMotion start_of(const CellDescription& cell) {
  PrescribedMotion start;
  start.axes.position = start_positions(cell);
  start.belts.resize(cell.conveyors.size());
  return start;
}

PartPose pose_of(const PartPlacement& placement) {
  return {placement.frame, placement.frame_from_part.translation(),
          Eigen::Quaterniond(placement.frame_from_part.linear())};
}

control::Collision collision_of(const CollisionReading& reading) {
  if (reading.begins) return control::Collision::kBegins;
  if (reading.deepens) return control::Collision::kDeepens;
  return reading.pairs > 0 ? control::Collision::kPresent : control::Collision::kNone;
}

/// The description with the part where the flange holds it as built.
CellDescription grasped(CellDescription cell, const AsBuilt& as_built) {
  PartDescription& part = cell.parts.front();
  if (holds_part(layout_of(cell))) part.support_from_part = displaced(part.support_from_part, as_built.grasp);
  return cell;
}

bool collides(const Readings& readings) { return readings.collision.pairs > 0; }

}  // namespace

Cell::Cell(const CellDescription& description, const proximity::BodySet& bodies,
           const CellParameters& parameters, std::string folder)
    : description_(grasped(description, parameters.as_built)),
      folder_(std::move(folder)),
      nominal_(description, AsBuilt{}),
      true_(description, parameters.as_built),
      encoders_(description, parameters.seed),
      vibration_(parameters.as_built, key_of_seeds(description.seed, parameters.seed)),
      belt_errors_(parameters.as_built.belt),
      nominal_arm_(description),
      controller_(settings_of(description), nominal_arm_, start_of(description).axes.position),
      world_(description_, true_, start_of(description)),
      sensing_(description, bodies, parameters.seed),
      trigger_(layout_of(description), parameters.as_built.trigger,
               key_of_seeds(description.seed, parameters.seed) + kTriggerKey),
      from_(layout_of(description)),
      to_(from_),
      history_(encoders_.max_latency_us()) {
  to_.prescribed = start_of(description);
  to_.parts.resize(description.parts.size());
  sensing_.initialize(to_.readings);
  read_axes(to_);
  read_world();
  from_ = to_;
  sensing_.place(frames_at(to_.time_us));
}

void Cell::read_world() {
  for (std::size_t i = 0; i < to_.parts.size(); ++i) to_.parts[i] = pose_of(world_.placement(i));
  to_.gripper = world_.gripper();
}

Events Cell::step(const CellInputs& inputs, double start_time, std::int64_t end_us, Events wanted,
                  const IntermediateUpdate& intermediate, std::size_t max_records) {
  const std::int64_t cycle_us = description_.controller_cycle_us;
  begin_step(inputs, start_time);
  while (time_us_ < end_us) {
    const std::int64_t next_cycle_us = (time_us_ / cycle_us + 1) * cycle_us;
    if (run(inputs, intermediate ? std::min(end_us, next_cycle_us) : end_us, wanted)) break;
    if (time_us_ < end_us) end_us = intermediate(time_us_, end_us);
  }
  return end_step(max_records);
}

void Cell::begin_step(const CellInputs& inputs, double start_time) {
  start_time_ = start_time;
  pendant_ = inputs.pendant;
  trigger_.command(inputs, time_us_, *this);
  collided_at_begin_ = collides(readings());
}

Events Cell::end_step(std::size_t max_records) {
  Events events = trigger_.publish(max_records) ? kRecordPublished : 0;
  if (collides(readings()) != collided_at_begin_) events |= kCollisionChanged;
  return events;
}

/// Advances to an instant, or to the first of the `wanted` events up to it. Returns whether one occurred.
bool Cell::run(const CellInputs& inputs, std::int64_t to_us, Events wanted) {
  bool at_event = false;
  while (time_us_ < to_us && !at_event) {
    if (time_us_ == to_.time_us) step_dynamics(inputs);
    std::int64_t end_us = std::min(to_us, to_.time_us);
    if (wanted != 0) {
      const std::int64_t event = next_event(wanted, end_us);
      at_event = event <= end_us;
      end_us = std::min(end_us, event);
    }
    trigger_.advance(time_us_, end_us, end_us == to_.time_us, *this);
    time_us_ = end_us;
  }
  return at_event;
}

/// First instant in (now, to] at which an event occurs, within the current dynamics step; a later instant
/// where there is none.
std::int64_t Cell::next_event(Events wanted, std::int64_t to_us) const {
  std::int64_t next = std::numeric_limits<std::int64_t>::max();
  if ((wanted & kRecordPublished) != 0) {
    next = trigger_.next_complete_us(time_us_, to_us, *this);
  }
  if ((wanted & kCollisionChanged) != 0 && collides(from_.readings) != collides(to_.readings)) {
    next = std::min(next, to_.time_us);
  }
  return std::max(next, time_us_ + 1);
}

/// The commanded segment; null where it is not available, with the reason in program_.fault.
std::shared_ptr<const control::ProgramSegment> Cell::requested_segment(const CellInputs& inputs) {
  const std::string& path = inputs.motion.program;
  program_.fault.clear();
  if (!program_.program || program_.path != path) {
    program_ = {path, nullptr, ""};
    try {
      if (path.empty()) throw DescriptionError("command.program is empty: expected the path of a saved plan");
      program_.program =
          read_program(is_absolute(path) ? path : folder_ + "/" + path, description_.joints.size(),
                       description_.axes.size(), description_.controller_cycle_us);
    } catch (const DescriptionError& error) {
      program_.fault = error.what();
      return nullptr;
    }
  }
  auto segment = control::find_segment(program_.program, inputs.segment);
  if (!segment) program_.fault = path + ": no segment has the id " + std::to_string(inputs.segment);
  return segment;
}

/// Microseconds from the start of a state that a message of the guard answers. 0 is the value of the input
/// before any message, also where the simulation starts at a negative time.
std::int64_t Cell::guard_instant(double guard_time) const {
  return guard_time == 0 ? 0 : std::llround((guard_time - start_time_) * kMicrosecondsPerSecond);
}

/// Reads the commands at an instant of the controller cycle.
void Cell::take_commands(const CellInputs& inputs) {
  control::Command command = command_of(inputs.motion, nominal_.flange_from_tool());
  if (command.mode == control::Mode::kProgram && controller_.starts(command)) {
    command.segment = requested_segment(inputs);
  }
  command.guard_us = guard_instant(inputs.motion.guard_time);
  if (description_.sensing.collision.stops_arm) command.collision = collision_of(to_.readings.collision);
  controller_.cycle(to_.time_us, command);
  for (std::size_t i = 0; i < description_.conveyors.size(); ++i) {
    const double limit = description_.conveyors[i].max_speed;
    to_.prescribed.belts[i].target = std::clamp(inputs.conveyors[i].speed, -limit, limit);
  }
  world_.command_gripper(inputs.gripper);
}

void Cell::step_dynamics(const CellInputs& inputs) {
  if (to_.time_us % description_.controller_cycle_us == 0) take_commands(inputs);
  if (encoders_.max_latency_us() > 0) history_.add({to_.time_us, to_.encoders});
  from_ = to_;
  to_.time_us += description_.time_step_us;
  const control::Knots knots = controller_.sample(to_.time_us);
  for (std::size_t i = 0; i < kAxes; ++i) {
    to_.prescribed.axes.position[i] = knots[i].position;
    to_.prescribed.axes.rate[i] = knots[i].velocity;
  }
  for (std::size_t i = 0; i < to_.prescribed.belts.size(); ++i) {
    to_.prescribed.belts[i] = belt_at(i, to_.time_us);
  }
  const std::int32_t fallbacks = world_.solver_fallbacks(), truncated = world_.truncated_contacts();
  world_.step(from_.prescribed, to_.prescribed);
  to_.solver_fallbacks += world_.solver_fallbacks() - fallbacks;
  to_.truncated_contacts += world_.truncated_contacts() - truncated;
  read_axes(to_);
  read_world();
  update_frames_of_parts();
  read_sensors();
}

/// Expresses the pose at the start of the step relative to the frame with which the part moves at its end.
/// With vibration the true pose there stays the same: the difference of the displacements becomes a residual
/// one.
void Cell::update_frames_of_parts() {
  const AxesState& axes = from_.true_axes;
  for (std::size_t i = 0; i < to_.parts.size(); ++i) {
    PartPose& from = from_.parts[i];
    const std::size_t before = from.frame, after = to_.parts[i].frame;
    if (before != after) {
      const auto still = [&](std::size_t frame) { return true_.frame(frame, axes.position, axes.rate).pose; };
      const auto displacement = [&](std::size_t frame) -> Eigen::Vector3d {
        const Motion moved = true_.frame(frame, axes.position, axes.rate, vibration_.at(from_.time_us));
        return moved.pose.translation() - still(frame).translation();
      };
      const Eigen::Vector3d residual =
          from.residual_displacement + displacement(before) - displacement(after);
      const Eigen::Isometry3d old_from_part = Eigen::Translation3d(from.position) * from.orientation;
      from = pose_of({after, still(after).inverse() * still(before) * old_from_part});
      from.residual_displacement = residual;
    }
    to_.parts[i].residual_displacement = residual_share(step_duration()) * from.residual_displacement;
  }
}

const Readings& Cell::readings() const { return time_us_ == to_.time_us ? to_.readings : from_.readings; }

void Cell::read_sensors() {
  if (sensing_.due(to_.time_us)) sensing_.read(to_.time_us, frames_at(to_.time_us), to_.readings);
}

/// Kinematic drives follow the set-points exactly. With dynamic drives the motors deviate from them, and the
/// links deflect and oscillate.
void Cell::read_axes(GridPoint& point) const {
  point.true_axes = point.encoders = point.prescribed.axes;
  if (!description_.dynamics) return;
  const ArmDynamicsState arm = world_.arm();
  for (std::size_t i = 0; i < description_.joints.size(); ++i) {
    point.true_axes.position[i] = arm.position[i];
    point.true_axes.rate[i] = arm.rate[i];
    point.encoders.position[i] = arm.motors[i].position;
    point.encoders.rate[i] = arm.motors[i].rate;
  }
}

CellState Cell::state() const {
  CellState state(layout_of(description_));
  state.time_us = time_us_;
  state.from = from_;
  state.to = to_;
  state.history = history_.states();
  state.controller = controller_.state();
  state.program = program_;
  state.world = world_.state();
  state.trigger = trigger_.state();
  state.pendant = pendant_;
  return state;
}

void Cell::restore(const CellState& state) {
  for (const GridPoint* point : {&state.from, &state.to}) {
    const bool known = std::all_of(point->parts.begin(), point->parts.end(),
                                   [&](const PartPose& part) { return part.frame < true_.tree().size(); });
    if (!known || point->parts.size() != to_.parts.size() ||
        point->prescribed.belts.size() != to_.prescribed.belts.size()) {
      throw std::invalid_argument("the state belongs to a cell with other devices");
    }
  }
  const std::int64_t step_us = state.to.time_us - state.from.time_us;
  if ((step_us != 0 && step_us != description_.time_step_us) || state.time_us < state.from.time_us ||
      state.time_us > state.to.time_us) {
    throw std::invalid_argument(
        "the times of the state are inconsistent: expected from <= time <= to, one time step apart");
  }
  for (const GridPoint* point : {&state.from, &state.to}) sensing_.check(point->readings);
  world_.restore(state.to.prescribed, state.world);
  time_us_ = state.time_us;
  from_ = state.from;
  to_ = state.to;
  history_.restore(state.history);
  controller_.restore(state.controller);
  program_ = state.program;
  trigger_.restore(state.trigger);
  pendant_ = state.pendant;
  sensing_.place(frames_at(to_.time_us));
}

}  // namespace robotcell
