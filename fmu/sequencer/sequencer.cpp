#include "fmu/sequencer/sequencer.h"

#include <stdexcept>

#include "fmu/control/time_units.h"
#include "fmu/fmi/number_text.h"
#include "fmu/fmi/sealed_state.h"
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

Sequencer::Sequencer(const CellDescription& cell, const std::string& name, const Log& log,
                     const StepOptions& options)
    : TableInstance(name, log, options),
      cycle_(static_cast<double>(cell.controller_cycle_us) / kMicrosecondsPerSecond),
      has_gripper_(cell.gripper.has_value()),
      start_(cell),
      values_(cell) {
  if (options.event_mode) throw std::invalid_argument("this FMU has no event mode");
  set_table(VariableTable(variables(layout_of(cell))));
}

std::vector<Variable> Sequencer::variables(const CellLayout& layout) {
  TableBuilder table(layout);
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

void Sequencer::start() {
  for (std::size_t i = 0; i < static_cast<std::size_t>(values_.count); ++i) {
    const auto until = static_cast<Until>(values_.steps[i].until);
    const bool unknown = (until == Until::kPresence && values_.cell.presence.size() == 0) ||
                         (until == Until::kGripped && !has_gripper_);
    if (!unknown) continue;
    throw std::invalid_argument(indexed("step", i) + ".until is " + std::to_string(values_.steps[i].until) +
                                ", but the cell has no " +
                                (until == Until::kGripped ? "gripper" : "presence sensor"));
  }
}

StepResult Sequencer::do_step(double current, double step) {
  const std::int64_t planned = begin_step(current, step);
  end_step(current, step, planned);
  values_.time = communication_time_;
  const std::int32_t before = values_.number;
  advance(step);
  if (values_.number != before) {
    log_.write(LogCategory::kEvent,
               "step " + std::to_string(values_.number) + " begins at " + seconds(values_.time));
  }
  return {};
}

void Sequencer::advance(double step) {
  if (values_.finished || values_.error != 0) return;
  if (values_.number > 0) {
    if (values_.cell.error != 0) return stop(values_.cell.error);
    if (!is_complete(values_.steps[static_cast<std::size_t>(values_.number - 1)], step)) return;
  }
  values_.finished = values_.number == values_.count;
  if (values_.finished) return;
  values_.command = values_.steps[static_cast<std::size_t>(values_.number++)].command;
  memory_ = values_.time;  // when the step began
}

/// The cell receives a command at the end of this communication step, its controller reads it within a cycle,
/// and what follows is an input of the sequencer a communication step later.
bool Sequencer::is_complete(const Step& step, double communication_step) const {
  const double elapsed = values_.time - memory_ + kHalfMicrosecond;
  const CellReadings& cell = values_.cell;
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
  log_.write(LogCategory::kWarning, "the sequence stops in step " + std::to_string(values_.number) +
                                        ": the cell rejects its command, controller.error is " +
                                        std::to_string(error));
  values_.command.motion.mode = static_cast<std::int32_t>(control::Mode::kHold);
  values_.command.trigger.mode = static_cast<std::int32_t>(TriggerMode::kOff);
  for (ConveyorCommand& belt : values_.command.conveyors) belt.speed = 0;
}

void Sequencer::check_restored() const {
  if (values_.number < 0 || values_.number > static_cast<std::int32_t>(kSteps)) reject_value();
}

}  // namespace robotcell::sequencer
