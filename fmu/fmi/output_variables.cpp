// Outputs: encoders, true state, trigger, controller.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

void add_truth(TableBuilder& table, Truth& truth, const Dependencies& dependencies) {
  const auto output = Causality::kOutput;
  const auto continuous = Variability::kContinuous;
  for (std::size_t i = 0; i < table.joints(); ++i) {
    table.add(indexed("truth.q", i), output, continuous, kRadian,
              "True angle of joint " + std::to_string(i + 1) +
                  " on the link side of the gear, without the zero error as_built.dh[i].theta",
              truth.position[i], dependencies.true_axes);
  }
  table.add("truth.table", output, continuous, kRadian, "True angle of the rotary table, not wrapped",
            truth.position[kTableAxis], dependencies.file);
  for (std::size_t i = 0; i < table.axes().size(); ++i) {
    const AxisLayout& axis = table.axes()[i];
    table.add("truth.axis." + axis.name, output, continuous, axis.slides ? kMetre : kRadian,
              "True position of the axis " + axis.name, truth.position[kFirstFurtherAxis + i],
              dependencies.file);
  }
  table.add_bodies("truth.", "", continuous, truth.bodies, dependencies.bodies);
}

void add_solver(TableBuilder& table, CellOutputs& out) {
  table.add(
      "truth.contact.solver_fallbacks", Causality::kOutput, Variability::kDiscrete, kNone,
      "Number of contact problems since the start whose forces are approximate: Dantzig's method failed, "
      "or the iteration on the friction cone did not converge; and of steps in which the friction of the "
      "joints of "
      "dynamic drives did not converge",
      out.solver_fallbacks);
  table.add(
      "truth.contact.truncated", Causality::kOutput, Variability::kDiscrete, kNone,
      "Number of times since the start that a pair of bodies had more than 250 contact points in a dynamics "
      "step: the collision detector finds no more of them, so that the points kept may not be the best ones",
      out.truncated_contacts);
}

void add_record(TableBuilder& table, CellOutputs& out) {
  const auto output = Causality::kOutput;
  const auto discrete = Variability::kDiscrete;
  TriggerRecord& record = out.trigger;
  table.add("trigger.count", output, discrete, kNone, "Number of exposures fired since the start",
            out.trigger_count);
  table.add("trigger.queued", output, discrete, kNone,
            "Number of complete records in the queue behind the current one", out.trigger_queued);
  table.set_clocked(true);
  table.add_declared("trigger.", "the trigger", output, record);
  table.add_declared("trigger.measured.", ", at the middle of the exposure of the current record", output,
                     record.measured);
  BodiesDependencies none;
  none.axes.resize(record.truth.axes.size());
  none.links.resize(record.truth.links.size());
  none.parts.resize(record.truth.parts.size());
  none.fingers.resize(record.truth.fingers.size());
  none.further_sensors.resize(record.truth.further_sensors.size());
  table.add_bodies("trigger.truth.", ", at the instant of the light of the current record", discrete,
                   record.truth, none);
  table.set_clocked(false);
}

std::string text_of_path_ahead(const std::string& cycles) {
  return " on the path of the running move or segment, " + cycles +
         " controller cycles of path clock ahead, at most at its end, or of the jog at full speed, held so "
         "long; "
         "at present where nothing runs";
}

}  // namespace

void add_path_ahead(TableBuilder& table, PerDevice<double>& ahead, PathAheadVariables variables,
                    const Dependencies& dependencies) {
  const std::size_t axes = table.joints() + 1 + table.axes().size();
  const auto points = static_cast<std::uint32_t>(ahead.size() / axes);
  if (variables == PathAheadVariables::kArray) {
    table.add("controller.ahead", Causality::kOutput, Variability::kContinuous, kRadian,
              (table.axes().empty() ? "Angles of the joints and of the table (columns)"
                                    : "Positions of joints, table and further axes (columns)") +
                  text_of_path_ahead("0, 1, 2, ... (rows)"),
              ahead[0], dependencies.file);
    table.make_array({points, static_cast<std::uint32_t>(axes)});
  }
  if (variables != PathAheadVariables::kScalars) return;
  for (std::size_t k = 0; k < points; ++k) {
    const std::string prefix = indexed("controller.ahead", k) + ".";
    const std::string text = text_of_path_ahead(std::to_string(k));
    for (std::size_t i = 0; i < axes; ++i) {
      const bool joint = i < table.joints();
      if (i > table.joints()) {
        const AxisLayout& axis = table.axes()[i - table.joints() - 1];
        table.add(prefix + "axis." + axis.name, Causality::kOutput, Variability::kContinuous,
                  axis.slides ? kMetre : kRadian, "Position of the axis " + axis.name + text,
                  ahead[k * axes + i], dependencies.file);
        continue;
      }
      table.add(joint ? indexed(prefix + "q", i) : prefix + "table", Causality::kOutput,
                Variability::kContinuous, kRadian,
                (joint ? "Angle of joint " + std::to_string(i + 1) : "Angle of the table") + text,
                ahead[k * axes + i], dependencies.file);
    }
  }
}

std::vector<RecordColumn> add_records(TableBuilder& table, std::int32_t& count) {
  const std::string prefix = "trigger.", arrays = "trigger.records.";
  std::vector<RecordColumn> columns;
  table.add(
      arrays + "count", Causality::kOutput, Variability::kDiscrete, kNone,
      "Number of records that became the current one in the last communication step, one after the other: "
      "all that were complete, but at most 256; the arrays trigger.records.* show the last ones, the oldest "
      "first, with 0 in further elements",
      count);
  table.bound(0, kMaxRecords);
  for (const Variable& variable : table.clocked_variables()) {
    columns.emplace_back(variable);
    table.add_array(variable, arrays + variable.name.substr(prefix.size()), columns.back().data(),
                    static_cast<std::uint32_t>(kMaxRecords));
  }
  return columns;
}

void add_motor_torques(TableBuilder& table, CellOutputs& out, const Dependencies& dependencies) {
  for (std::size_t i = 0; i < table.joints(); ++i) {
    table.add(indexed("measured.torque", i), Causality::kOutput, Variability::kDiscrete, kNewtonMetre,
              "Motor torque of joint " + std::to_string(i + 1) +
                  " as reported by its drive, referred to the output side of the gear",
              out.motor_torque[i], dependencies.true_axes);
  }
}

void add_outputs(TableBuilder& table, CellOutputs& out, const Dependencies& dependencies) {
  table.add_declared("measured.", "", Causality::kOutput, out.measured, dependencies);
  add_truth(table, out.truth, dependencies);
  add_solver(table, out);
  add_record(table, out);
  table.add_declared("controller.", "the controller", Causality::kOutput, out.controller, dependencies);
  table.add_declared("pendant.", "the pendant", Causality::kOutput, out.pendant);
}

}  // namespace robotcell::fmi
