#include "fmu/model/cell.h"

#include <algorithm>
#include <limits>
#include <stdexcept>

#include "fmu/model/random.h"

namespace robotcell {
namespace {

constexpr std::uint64_t kTriggerKey = 0x7472696767657200;

Imposed start_of(const CellDescription& cell) {
  Imposed start;
  for (std::size_t i = 0; i < kJoints; ++i) start.axes.position[i] = cell.joints[i].start;
  start.axes.position[kTableAxis] = cell.table.start;
  start.belts.resize(cell.conveyors.size());
  return start;
}

PartPose pose_of(const PartPlace& place) {
  return {place.carrier, place.carrier_from_part.translation(),
          Eigen::Quaterniond(place.carrier_from_part.linear())};
}

bool collides(const Readings& readings) { return readings.collision.pairs > 0; }

}  // namespace

Cell::Cell(const CellDescription& description, const CellParameters& parameters)
    : description_(description),
      nominal_(description, AsBuilt{}),
      true_(description, parameters.as_built),
      encoders_(description, parameters.seed),
      shaking_(description, parameters.as_built, key_of_seeds(description.seed, parameters.seed)),
      nominal_arm_(description),
      controller_(settings_of(description), nominal_arm_, start_of(description).axes.position),
      world_(description, true_, start_of(description)),
      senses_(description, parameters.seed),
      trigger_(layout_of(description), parameters.as_built.trigger,
               key_of_seeds(description.seed, parameters.seed) + kTriggerKey),
      history_(encoders_.longest_latency_us()) {
  to_.imposed = start_of(description);
  to_.parts.resize(description.parts.size());
  to_.readings = senses_.nothing();
  read_axes(to_);
  see_world();
  from_ = to_;
}

void Cell::see_world() {
  for (std::size_t i = 0; i < to_.parts.size(); ++i) to_.parts[i] = pose_of(world_.place(i));
  to_.gripper = world_.gripper();
}

void Cell::begin_step(const CellInputs& inputs) {
  command_of(inputs.motion);  // refuses what makes no sense before anything happens
  if (inputs.trigger.mode < 0 || inputs.trigger.mode > static_cast<std::int32_t>(TriggerMode::kRequest)) {
    throw std::invalid_argument("command.trigger.mode must be from 0 to 4");
  }
  if (inputs.gripper.mode < 0 || inputs.gripper.mode > static_cast<std::int32_t>(GripperMode::kForce)) {
    throw std::invalid_argument("command.gripper.mode must be from 0 to 2");
  }
  trigger_.command(inputs, time_us_, *this);
  collided_at_begin_ = collides(readings());
}

Events Cell::end_step() {
  Events events = trigger_.show_next() ? kRecordShown : 0;
  if (collides(readings()) != collided_at_begin_) events |= kCollisionChanged;
  return events;
}

std::int64_t Cell::run(const CellInputs& inputs, std::int64_t to_us, Events wanted) {
  bool at_event = false;
  while (time_us_ < to_us && !at_event) {
    if (time_us_ == to_.time_us) step_dynamics(inputs);
    std::int64_t until = std::min(to_us, to_.time_us);
    if (wanted != 0) {
      const std::int64_t event = next_event(wanted, until);
      at_event = event <= until;
      until = std::min(until, event);
    }
    trigger_.watch(time_us_, until, until == to_.time_us, *this);
    trigger_.latch(until, *this);
    time_us_ = until;
  }
  return time_us_;
}

/// First instant after the present and up to `to`, in the running dynamics step, at which an event comes; a
/// later instant where none does. Sources look ahead and change nothing: what would happen behind the stop
/// must not have happened yet.
std::int64_t Cell::next_event(Events wanted, std::int64_t to_us) const {
  std::int64_t next = std::numeric_limits<std::int64_t>::max();
  if ((wanted & kRecordShown) != 0) {
    Trigger ahead = trigger_;
    ahead.watch(time_us_, to_us, false, *this);
    next = std::min(next, ahead.next_ready());
  }
  if ((wanted & kCollisionChanged) != 0 && collides(from_.readings) != collides(to_.readings)) {
    next = std::min(next, to_.time_us);
  }
  return std::max(next, time_us_ + 1);
}

/// At an instant of the controller's cycle.
void Cell::take_commands(const CellInputs& inputs) {
  controller_.cycle(to_.time_us, command_of(inputs.motion));
  for (std::size_t i = 0; i < description_.conveyors.size(); ++i) {
    const double limit = description_.conveyors[i].max_speed;
    to_.imposed.belts[i].target = std::clamp(inputs.conveyors[i].speed, -limit, limit);
  }
  const GripperCommandInputs& gripper = inputs.gripper;
  world_.command_gripper({static_cast<GripperMode>(gripper.mode), gripper.width, gripper.force});
}

void Cell::step_dynamics(const CellInputs& inputs) {
  if (to_.time_us % description_.controller_cycle_us == 0) take_commands(inputs);
  if (encoders_.longest_latency_us() > 0) history_.add({to_.time_us, to_.encoders});
  from_ = to_;
  to_.time_us += description_.time_step_us;
  const control::Knots knots = controller_.sample(to_.time_us);
  for (std::size_t i = 0; i < kAxes; ++i) {
    to_.imposed.axes.position[i] = knots[i].position;
    to_.imposed.axes.rate[i] = knots[i].velocity;
  }
  for (std::size_t i = 0; i < to_.imposed.belts.size(); ++i) to_.imposed.belts[i] = belt_at(i, to_.time_us);
  world_.step(from_.imposed, to_.imposed);
  read_axes(to_);
  see_world();
  hand_over_parts();
  read_sensors();
}

/// Where a part was when the step began, seen from what carries it when the step ends.
void Cell::hand_over_parts() {
  const auto world_from = [this](Carrier carrier) -> Eigen::Isometry3d {
    const AxesState& axes = from_.true_axes;
    if (carrier == Carrier::kPlatter) return true_.platter(axes.position[kTableAxis], 0).pose;
    if (carrier == Carrier::kFlange) return true_.arm(axes.position, axes.rate).back().pose;
    return Eigen::Isometry3d::Identity();
  };
  for (std::size_t i = 0; i < to_.parts.size(); ++i) {
    PartPose& from = from_.parts[i];
    const Carrier carrier = to_.parts[i].carrier;
    if (from.carrier == carrier) continue;
    const Eigen::Isometry3d old_from_part = Eigen::Translation3d(from.position) * from.orientation;
    from = pose_of({carrier, world_from(carrier).inverse() * world_from(from.carrier) * old_from_part});
  }
}

const Readings& Cell::readings() const { return time_us_ == to_.time_us ? to_.readings : from_.readings; }

void Cell::read_sensors() {
  if (!senses_.due(to_.time_us)) return;
  Bodies truth(layout_of(description_));
  write_truth(to_.time_us, truth);
  senses_.read(to_.time_us, truth, to_.readings);
}

/// Kinematic drives are where they should be; motors of dynamic ones nearly so, and the links sag and swing.
void Cell::read_axes(GridPoint& point) const {
  point.true_axes = point.encoders = point.imposed.axes;
  if (!description_.dynamics) return;
  const ArmDynamicsState arm = world_.arm();
  for (std::size_t i = 0; i < kJoints; ++i) {
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
  state.arm = world_.arm();
  state.parts = world_.free_parts();
  state.grasp = world_.grasp();
  state.trigger = trigger_.state();
  return state;
}

void Cell::restore(const CellState& state) {
  for (const GridPoint* point : {&state.from, &state.to}) {
    if (point->parts.size() != to_.parts.size() || point->imposed.belts.size() != to_.imposed.belts.size() ||
        point->readings.presence.size() != to_.readings.presence.size() ||
        point->readings.distance.size() != to_.readings.distance.size()) {
      throw std::invalid_argument("the state holds devices that this cell does not have");
    }
  }
  const std::int64_t begun = state.to.time_us - state.from.time_us;
  if ((begun != 0 && begun != description_.time_step_us) || state.time_us < state.from.time_us ||
      state.time_us > state.to.time_us) {
    throw std::invalid_argument("the state's times contradict each other");
  }
  world_.restore(state.to.imposed, state.arm, state.parts, state.grasp);
  time_us_ = state.time_us;
  from_ = state.from;
  to_ = state.to;
  history_.restore(state.history);
  controller_.restore(state.controller);
  trigger_.restore(state.trigger);
}

}  // namespace robotcell
