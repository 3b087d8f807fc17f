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
  table.add_bodies("truth.", "", continuous, truth.bodies, dependencies.bodies);
}

void add_solver(TableBuilder& table, CellOutputs& out) {
  table.add(
      "truth.contact.solver_fallbacks", Causality::kOutput, Variability::kDiscrete, kNone,
      "Number of contact problems since the start whose forces are approximate: Dantzig's method failed, "
      "or the iteration on the friction cone did not converge",
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
  table.add_declared("trigger.", "the trigger", output, record);
  table.add_declared("trigger.measured.", ", at the middle of the exposure of the current record", output,
                     record.measured);
  BodiesDependencies none;
  none.links.resize(record.truth.links.size());
  none.parts.resize(record.truth.parts.size());
  none.fingers.resize(record.truth.fingers.size());
  table.add_bodies("trigger.truth.", ", at the instant of the light of the current record", discrete,
                   record.truth, none);
}

void add_path_ahead(TableBuilder& table, control::PathAhead& ahead, const Dependencies& dependencies) {
  for (std::size_t k = 0; k < ahead.size(); ++k) {
    const std::string prefix = indexed("controller.ahead", k) + ".";
    const std::string text = " on the path of the running move or segment, " + std::to_string(k) +
                             " controller cycles of path clock ahead, at most at its end, or of the jog at "
                             "full speed, held so long; "
                             "at present where nothing runs";
    for (std::size_t i = 0; i < table.joints(); ++i) {
      table.add(indexed(prefix + "q", i), Causality::kOutput, Variability::kContinuous, kRadian,
                "Angle of joint " + std::to_string(i + 1) + text, ahead[k][i], dependencies.file);
    }
    table.add(prefix + "table", Causality::kOutput, Variability::kContinuous, kRadian,
              "Angle of the table" + text, ahead[k][kTableAxis], dependencies.file);
  }
}

}  // namespace

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
  add_path_ahead(table, out.ahead, dependencies);
  table.add_declared("pendant.", "the pendant", Causality::kOutput, out.pendant);
}

}  // namespace robotcell::fmi
