#include "fmu/fmi/snapshot.h"

#include "fmu/fmi/archive.h"
#include "fmu/fmi/sealed_state.h"

namespace robotcell::fmi {

template <>
constexpr Phase kLast<Phase> = Phase::kEvent;  // kIntermediate is never part of a state
template <>
constexpr TriggerGate kLast<TriggerGate> = TriggerGate::kPassed;

}  // namespace robotcell::fmi

// Found by argument-dependent lookup, so each function is in the namespace of its structure.
namespace robotcell {

using fmi::within;

template <class A>
void exchange(A& a, CellParameters& v) {
  ROBOTCELL_EXCHANGE(a, v, v.cell_file, v.seed, v.as_built);
}
template <class A>
void exchange(A& a, CellInputs& v) {
  ROBOTCELL_EXCHANGE(a, v, v.motion, v.segment, v.trigger, v.exposure, v.conveyors, v.gripper, v.pendant);
}
template <class A>
void exchange(A& a, PendingRecord& v) {
  ROBOTCELL_EXCHANGE(a, v, v.middle_us, v.light_us, v.measured, v.illuminated, v.record);
}
template <class A>
void exchange(A& a, TriggerState& v) {
  // The current record has the layout of all others.
  const auto pending =
      fmi::special(v.pending, [&] { fmi::exchange_sequence(a, v.pending, PendingRecord(v.current_record)); });
  const auto published =
      fmi::special(v.published, [&] { fmi::exchange_sequence(a, v.published, v.current_record); });
  ROBOTCELL_EXCHANGE(a, v, v.command, v.segment, v.exposure, v.count, v.entered_us, v.fired_since_entry,
                     v.skipped, v.gated, v.gate, v.run, v.entry_angle, v.entry_travel, v.path,
                     v.path_reference, pending, v.incomplete, v.current_record, published, v.newly_published);
}
template <class A>
void exchange(A& a, AxesState& v) {
  ROBOTCELL_EXCHANGE(a, v, v.position, v.rate);
}
template <class A>
void exchange(A& a, PartPose& v) {
  ROBOTCELL_EXCHANGE(a, v, v.frame, v.position, v.orientation, v.residual_displacement);
}
template <class A>
void exchange(A& a, StickConstraint& v) {
  ROBOTCELL_EXCHANGE(a, v, v.support, v.normal, v.support_from_body);
}
template <class A>
void exchange(A& a, GraspState& v) {
  ROBOTCELL_EXCHANGE(a, v, v.gripper, v.arm_speed);
}
template <class A>
void exchange(A& a, SoftPoint& v) {
  ROBOTCELL_EXCHANGE(a, v, v.displacement, v.velocity);
}
template <class A>
void exchange(A& a, FreePartState& v) {
  ROBOTCELL_EXCHANGE(a, v, v.position, v.velocity, v.main_support, v.stick_constraint, v.points);
}

template <class A>
void exchange(A& a, Readings& v) {
  ROBOTCELL_EXCHANGE(a, v, v.sensors, v.collision);
}

namespace control {

using fmi::up_to;
using fmi::within;

template <class A>
void exchange(A& a, Knot& v) {
  ROBOTCELL_EXCHANGE(a, v, v.position, v.velocity);
}
template <class A>
void exchange(A& a, ServoState& v) {
  ROBOTCELL_EXCHANGE(a, v, v.start_us, v.set_point, v.set_point_before, v.start, v.end, v.duration_us,
                     up_to(a, kAxes, v.limit));
  if (A::kReads && !(v.duration_us > 0)) fmi::reject_value();
}
template <class A>
void exchange(A& a, MotionPath& v) {
  ROBOTCELL_EXCHANGE(a, v, v.line, v.from, v.to, v.start_position, v.start_orientation, v.translation,
                     v.rotation_vector);
}
template <class A>
void exchange(A& a, SmoothProfile& v) {
  ROBOTCELL_EXCHANGE(a, v, v.distance, v.speed, v.ramp);
}
template <class A>
void exchange(A& a, ProgramSegment& v) {
  ROBOTCELL_EXCHANGE(a, v, v.id, v.spacing, v.knots);
  if (A::kReads && (v.knots.size() < 2 || !(v.spacing > 0))) fmi::reject_value();
}
template <class A>
void exchange(A& a, Program& v) {
  ROBOTCELL_EXCHANGE(a, v, v.segments);
}
template <class A>
void exchange(A& a, ClockPoint& v) {
  ROBOTCELL_EXCHANGE(a, v, v.clock, v.rate);
}
template <class A>
void exchange(A& a, MoveState& v) {
  ROBOTCELL_EXCHANGE(a, v, v.active, v.segment, v.path, v.profile, v.start, v.end);
}
template <class A>
void exchange(A& a, JogState& v) {
  ROBOTCELL_EXCHANGE(a, v, v.position, v.orientation, v.speed, v.brakes_first, v.blocked, v.error,
                     up_to(a, kAxes, v.limit));
}
template <class A>
void exchange(A& a, PendingMove& v) {
  ROBOTCELL_EXCHANGE(a, v, v.pending, v.mode, v.segment, v.position, v.has_pose, v.flange_from_tool,
                     v.tool_position, v.tool_orientation, v.speed);
}
template <class A>
void exchange(A& a, GuardWatch& v) {
  ROBOTCELL_EXCHANGE(a, v, v.answered_us, v.path_us, v.guarded, v.share, v.stopped);
}
template <class A>
void exchange(A& a, JogPermit& v) {
  ROBOTCELL_EXCHANGE(a, v, v.mode, v.frame, v.direction, v.speed, v.given);
}
template <class A>
void exchange(A& a, ControllerState& v) {
  ROBOTCELL_EXCHANGE(a, v, v.servo, v.move, v.jog, v.pending_move, v.flange_from_tool, v.mode, v.phase,
                     v.stopped, v.error, v.path_error, up_to(a, kAxes, v.path_limit), v.start, v.reset,
                     v.heartbeat, v.heartbeat_us, v.guard, v.jog_permit, v.advanced_us, v.runs, v.destination,
                     v.free);
}
}  // namespace control

template <class A>
void exchange(A& a, PrescribedMotion& v) {
  ROBOTCELL_EXCHANGE(a, v, v.axes, v.belts);
}
template <class A>
void exchange(A& a, WorldState& v) {
  ROBOTCELL_EXCHANGE(a, v, v.arm, v.parts, v.grasp);
}
template <class A>
void exchange(A& a, GridPoint& v) {
  ROBOTCELL_EXCHANGE(a, v, v.time_us, v.prescribed, v.true_axes, v.encoders, v.parts, v.gripper, v.readings,
                     v.solver_fallbacks, v.truncated_contacts);
}
template <class A>
void exchange(A& a, TimedAxes& v) {
  ROBOTCELL_EXCHANGE(a, v, v.time_us, v.axes);
}
template <class A>
void exchange(A& a, LoadedProgram& v) {
  ROBOTCELL_EXCHANGE(a, v, v.path, v.program, v.fault);
}
template <class A>
void exchange(A& a, CellState& v) {
  constexpr double kMax = fmi::kMaxMagnitude;
  ROBOTCELL_EXCHANGE(a, v, v.time_us, within(a, kMax, v.from), within(a, kMax, v.to),
                     within(a, kMax, v.history), v.controller, v.program, within(a, kMax, v.world), v.trigger,
                     v.pendant);
}

}  // namespace robotcell

namespace robotcell::fmi {
namespace {

template <class Archive>
void exchange_snapshot(Archive& archive, Snapshot& snapshot, const CellLayout& layout) {
  const auto stop_time =
      special(snapshot.stop_time, [&] { exchange_unless_infinite(archive, snapshot.stop_time); });
  const auto cell = special(snapshot.cell, [&] {
    bool has_cell = Archive::kDescribes || snapshot.cell.has_value();
    exchange(archive, has_cell);
    if (has_cell && !snapshot.cell) snapshot.cell.emplace(layout);
    if (has_cell) exchange(archive, *snapshot.cell);
  });
  ROBOTCELL_EXCHANGE(archive, snapshot, snapshot.phase, snapshot.start_time, stop_time,
                     snapshot.communication_time, snapshot.events, snapshot.parameters, snapshot.inputs,
                     snapshot.home_inputs_set, snapshot.description_hash, cell);
}

std::vector<std::uint8_t> bytes_of(CellParameters& parameters) {
  Writer writer;
  exchange(writer, parameters);
  return writer.take();
}

}  // namespace

std::uint64_t state_layout() {
  static const std::uint64_t layout = [] {
    LayoutHash archive;
    Snapshot empty({});
    exchange_snapshot(archive, empty, {});
    return archive.value();
  }();
  return layout;
}

bool same_parameters(CellParameters a, CellParameters b) { return bytes_of(a) == bytes_of(b); }

std::vector<std::uint8_t> serialize(const Snapshot& snapshot, const std::string& token) {
  Writer writer = sealed_writer(token, state_layout());
  exchange_snapshot(writer, const_cast<Snapshot&>(snapshot), {});  // writing changes nothing
  return sealed(writer);
}

Snapshot deserialize(const std::uint8_t* bytes, std::size_t size, const CellLayout& layout,
                     const std::string& token) {
  Reader reader = unsealed(bytes, size, token, state_layout());
  Snapshot snapshot(layout);
  exchange_snapshot(reader, snapshot, layout);
  check_end(reader);
  return snapshot;
}

}  // namespace robotcell::fmi
