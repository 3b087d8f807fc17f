// Sequencer: commands a cell step by step, as a programmable logic controller does. An example of an FMU that
// drives the cell's.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "fmu/fmi/table_instance.h"
#include "fmu/model/description/cell_description.h"

namespace robotcell::sequencer {

constexpr std::size_t kSteps = 20;

/// What ends a step, at the earliest after its duration.
enum class Until : std::int32_t { kTime, kMotion, kPresence, kGripped };
inline constexpr EnumerationItem kUntilItems[] = {
    {"time", "nothing else"},
    {"motion", "controller.at_destination"},
    {"presence", "presence[1].detected"},
    {"gripped", "measured.gripper.gripped"},
};

/// Values of all inputs of the cell during a step.
struct Step {
  CellInputs command;
  double duration = 0;  // s
  std::int32_t until = 0;
};

/// Outputs of the cell that the sequencer reads.
struct CellReadings {
  bool at_destination = true;
  std::int32_t error = 0;  // of the controller
  bool gripped = false;
  PerDevice<PresenceSensor::Reading> presence;
};

/// The sequence with its inputs and outputs, as variables.
class Sequencer : public fmi::TableInstance {
 public:
  /// For a cell of this layout; all steps start with the cell's own start values.
  explicit Sequencer(const CellDescription& cell, const std::string& name = "sequencer",
                     const fmi::Log& log = fmi::Log({}, false), const fmi::StepOptions& options = {});

  fmi::StepResult do_step(double current, double step) override;

 private:
  struct Values {
    explicit Values(const CellDescription& description);

    double time = 0;         // s
    std::int32_t count = 0;  // of steps that are used
    PerDevice<Step> steps;
    CellReadings cell;
    CellInputs command;       // of the present step
    std::int32_t number = 0;  // of the present step, counted from 1
    bool finished = false;
    std::int32_t error = 0;  // of the controller, at which the sequence stopped
  };

  void start() override;
  void clear() override {
    values_ = start_;
    memory_ = 0;
  }
  void check_restored() const override;
  void before_get(const fmi::Variable& /*variable*/) override { values_.time = communication_time_; }
  std::vector<fmi::Variable> variables(const CellLayout& layout);
  void advance(double step);
  bool is_complete(const Step& step, double communication_step) const;
  void stop(std::int32_t error);

  double cycle_;  // s, of the cell's controller
  bool has_gripper_;
  Values start_;
  Values values_;
};

}  // namespace robotcell::sequencer

namespace robotcell {

template <>
inline constexpr Enumeration enumeration_of<sequencer::Until> = make_enumeration("Until",
                                                                                 sequencer::kUntilItems);

}  // namespace robotcell
