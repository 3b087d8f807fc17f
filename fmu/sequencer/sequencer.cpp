#include "fmu/sequencer/sequencer.h"

#include <cmath>
#include <stdexcept>

#include "fmu/control/time_units.h"
#include "fmu/fmi/table_groups.h"
#include "fmu/model/start_inputs.h"

namespace robotcell::sequencer {

using namespace fmi;

namespace {

constexpr double kHalfMicrosecond = 0.5 / kMicrosecondsPerSecond;

/// All commands to a cell; `prefix` begins their names.
void add_all_commands(TableBuilder& table, const CellLayout& layout, CellInputs& in,
                      const std::string& prefix, Causality causality) {
  add_commands(table, in, prefix, causality);
  add_conveyor_commands(table, in, prefix, causality);
  if (layout.gripper) table.add_declared(prefix + "gripper.", "the gripper", causality, in.gripper);
}

}  // namespace

Sequencer::Values::Values(const CellDescription& description)
    : steps(kSteps, Step{start_inputs(description)}),
      cell{true, 0, false,
           PerDevice<PresenceSensor::Reading>(
               std::get<std::vector<PresenceSensor>>(description.sensing.sensors).size())},
      command(start_inputs(description)) {}

Sequencer::Sequencer(const CellDescription& cell)
    : cycle_(static_cast<double>(cell.controller_cycle_us) / kMicrosecondsPerSecond),
      has_gripper_(cell.gripper.has_value()),
      start_(cell),
      values_(cell),
      table_(variables(layout_of(cell))) {}

std::vector<Variable> Sequencer::variables(const CellLayout& layout) {
  TableBuilder table(layout.joints.size());
  const auto discrete = Variability::kDiscrete;
  table.add("time", Causality::kIndependent, Variability::kContinuous, kSecond, "Simulation time",
            values_.time);
  const auto parameter = Causality::kParameter;
  table.add("steps", parameter, Variability::kFixed, kNone, "Number of steps that are used; 0: no command",
            values_.count);
  table.bound(0, kSteps);
  for (std::size_t i = 0; i < kSteps; ++i) {
    Step& step = values_.steps[i];
    const std::string prefix = indexed("step", i) + ".";
    table.add(prefix + "duration", parameter, Variability::kFixed, kSecond, "Shortest duration of the step",
              step.duration);
    table.bound(0, kMaxDuration);
    table.add(prefix + "until", parameter, Variability::kFixed, kNone,
              "What ends the step after its duration", step.until);
    table.enumerate(enumeration_of<Until>);
    add_all_commands(table, layout, step.command, prefix, parameter);
  }
  const auto input = Causality::kInput;
  table.add("controller.at_destination", input, discrete, kNone,
            "True while all axes of the cell are at rest at their destination", values_.cell.at_destination);
  table.add("controller.error", input, discrete, kNone,
            "Reason for which the cell rejects a command; 0: none", values_.cell.error);
  for (std::size_t i = 0; i < values_.cell.presence.size(); ++i) {
    table.add_declared(indexed("presence", i) + ".", "presence sensor " + std::to_string(i + 1), input,
                       values_.cell.presence[i]);
  }
  if (layout.gripper) {
    table.add("measured.gripper.gripped", input, discrete, kNone, "True if the gripper holds an object",
              values_.cell.gripped);
  }
  const auto output = Causality::kOutput;
  add_all_commands(table, layout, values_.command, "command.", output);
  table.add("number", output, discrete, kNone,
            "Number of the present step, counted from 1; 0 before the first", values_.number);
  table.add("finished", output, discrete, kNone, "True after the last step; its commands stay",
            values_.finished);
  table.add("error", output, discrete, kNone,
            "Value of controller.error at which the sequence stopped in mode 0; 0: none", values_.error);
  return table.take();
}

void Sequencer::setup(double start_time) {
  if (phase_ != Phase::kInstantiated) reject_call("setting up the experiment", phase_);
  values_.time = start_time;
}

void Sequencer::enter_initialization() {
  if (phase_ != Phase::kInstantiated) reject_call("entering initialization mode", phase_);
  phase_ = Phase::kInitialization;
}

void Sequencer::exit_initialization() {
  if (phase_ != Phase::kInitialization) reject_call("leaving initialization mode", phase_);
  for (std::size_t i = 0; i < static_cast<std::size_t>(values_.count); ++i) {
    const auto until = static_cast<Until>(values_.steps[i].until);
    const bool unknown = (until == Until::kPresence && values_.cell.presence.size() == 0) ||
                         (until == Until::kGripped && !has_gripper_);
    if (!unknown) continue;
    throw std::invalid_argument(indexed("step", i) + ".until is " + std::to_string(values_.steps[i].until) +
                                ", but the cell has no " +
                                (until == Until::kGripped ? "gripper" : "presence sensor"));
  }
  phase_ = Phase::kStepping;
}

void Sequencer::terminate() {
  if (phase_ != Phase::kStepping) reject_call("terminating", phase_);
  phase_ = Phase::kTerminated;
}

void Sequencer::reset() {
  values_ = start_;
  phase_ = Phase::kInstantiated;
}

void Sequencer::do_step(double current, double step) {
  if (phase_ != Phase::kStepping) reject_call("a step", phase_);
  if (!(step > 0) || !(std::abs(current - values_.time) <= kHalfMicrosecond)) {
    throw std::invalid_argument("the step must begin at " + std::to_string(values_.time) +
                                " s and have a positive size, not " + std::to_string(current) + " s and " +
                                std::to_string(step) + " s");
  }
  values_.time = current + step;
  if (values_.finished || values_.error != 0) return;
  if (values_.number > 0) {
    if (values_.cell.error != 0) return stop(values_.cell.error);
    if (!is_complete(values_.steps[static_cast<std::size_t>(values_.number - 1)], step)) return;
  }
  values_.finished = values_.number == values_.count;
  if (values_.finished) return;
  values_.command = values_.steps[static_cast<std::size_t>(values_.number++)].command;
  values_.began = values_.time;
}

/// The cell receives a command at the end of this communication step, its controller reads it within a cycle,
/// and what follows is an input of the sequencer a communication step later.
bool Sequencer::is_complete(const Step& step, double communication_step) const {
  const double elapsed = values_.time - values_.began + kHalfMicrosecond;
  const CellState& cell = values_.cell;
  if (elapsed < step.duration) return false;
  switch (static_cast<Until>(step.until)) {
    case Until::kTime:
      return true;
    case Until::kMotion:
      return cell.at_destination && elapsed >= cycle_ + 2 * communication_step;
    case Until::kPresence:
      return cell.presence[0].detected;
    case Until::kGripped:
      return cell.gripped && elapsed >= cycle_ + 2 * communication_step;
  }
  return true;
}

/// The axes and belts stop; the gripper keeps its command.
void Sequencer::stop(std::int32_t error) {
  values_.error = error;
  values_.command.motion.mode = static_cast<std::int32_t>(control::Mode::kHold);
  values_.command.trigger.mode = static_cast<std::int32_t>(TriggerMode::kOff);
  for (ConveyorCommand& belt : values_.command.conveyors) belt.speed = 0;
}

/// The functions for integers serve enumerations, too.
template <class T>
const Variable& Sequencer::typed(std::uint32_t reference) const {
  const Variable& found = table_.at(reference);
  const Type type = found.type == Type::kEnumeration ? Type::kInteger : found.type;
  if (type != TypeOf<T>::value) {
    throw std::invalid_argument(found.name + " has another type than the called function");
  }
  return found;
}

template <class T>
void Sequencer::set(std::uint32_t reference, const T& value) {
  const Variable& found = typed<T>(reference);
  if (!is_settable(found)) throw std::invalid_argument(found.name + " is neither an input nor a parameter");
  const bool early = phase_ == Phase::kInstantiated || phase_ == Phase::kInitialization;
  if (!early && !(found.causality == Causality::kInput && phase_ == Phase::kStepping)) {
    reject_call("setting " + found.name, phase_);
  }
  if constexpr (std::is_same_v<T, double> || std::is_same_v<T, std::int32_t>) {
    const auto number = static_cast<double>(value);
    if (!std::isfinite(number) || number < found.min || number > found.max) {
      throw std::invalid_argument(out_of_range(found, number));
    }
  }
  member<T>(found) = value;
}

template const Variable& Sequencer::typed<double>(std::uint32_t) const;
template const Variable& Sequencer::typed<std::int32_t>(std::uint32_t) const;
template const Variable& Sequencer::typed<bool>(std::uint32_t) const;
template const Variable& Sequencer::typed<std::string>(std::uint32_t) const;
template void Sequencer::set(std::uint32_t, const double&);
template void Sequencer::set(std::uint32_t, const std::int32_t&);
template void Sequencer::set(std::uint32_t, const bool&);
template void Sequencer::set(std::uint32_t, const std::string&);

}  // namespace robotcell::sequencer
