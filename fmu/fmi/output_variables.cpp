// Outputs of encoders, truth, trigger and controller.
#include "fmu/fmi/table_groups.h"

namespace robotcell::fmi {
namespace {

void add_truth(TableBuilder& table, Truth& truth, const Dependencies& known) {
  const auto output = Causality::kOutput;
  const auto continuous = Variability::kContinuous;
  for (std::size_t i = 0; i < kJoints; ++i) {
    table.add(indexed("truth.q", i), output, continuous, kRadian,
              "True angle of joint " + std::to_string(i + 1) +
                  ", where dynamic drives leave the link; the zero error of the arm as built comes on top",
              truth.position[i], known.true_axes);
  }
  table.add("truth.table", output, continuous, kRadian, "True angle of the table, not wrapped",
            truth.position[kTableAxis], known.file);
  table.add_bodies("truth.", "", continuous, truth.bodies, known.bodies);
}

void add_record(TableBuilder& table, CellOutputs& out) {
  const auto output = Causality::kOutput;
  const auto discrete = Variability::kDiscrete;
  TriggerRecord& record = out.trigger;
  table.add("trigger.count", output, discrete, kNone, "Exposures fired so far", out.trigger_count);
  table.add("trigger.index", output, discrete, kNone,
            "Number of the exposure whose record is on display, counted from 1; 0 before the first. Every "
            "communication step displays the next finished record, if there is one",
            record.index);
  table.add("trigger.queued", output, discrete, kNone, "Finished records that wait for their display",
            out.trigger_queued);
  table.add("trigger.time", output, discrete, kSecond, "Middle of the exposure on display", record.time);
  table.add("trigger.exposure", output, discrete, kSecond, "Duration of the exposure on display",
            record.exposure);
  table.add("trigger.segment", output, discrete, kNone, "Path segment in which the exposure on display fired",
            record.segment);
  table.add_measurement("trigger.measured.", ", latched in the middle of the exposure on display",
                        record.measured, {});
  BodiesDependencies none;
  none.parts.resize(record.truth.parts.size());
  none.fingers.resize(record.truth.fingers.size());
  table.add_bodies("trigger.truth.", ", when the light of the exposure on display came", discrete,
                   record.truth, none);
}

}  // namespace

void add_motor_torques(TableBuilder& table, CellOutputs& out, const Dependencies& known) {
  for (std::size_t i = 0; i < kJoints; ++i) {
    table.add(indexed("measured.torque", i), Causality::kOutput, Variability::kDiscrete, kNewtonMetre,
              "Torque of the motor of joint " + std::to_string(i + 1) +
                  ", as its drive reports it, behind the gear",
              out.motor_torque[i], known.true_axes);
  }
}

void add_outputs(TableBuilder& table, CellOutputs& out, const Dependencies& known) {
  table.add_measurement("measured.", "", out.measured, known.measured);
  add_truth(table, out.truth, known);
  add_record(table, out);
  add_controller(table, out.controller, known);
}

}  // namespace robotcell::fmi
