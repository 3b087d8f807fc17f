// Sequencer: commands a cell step by step, as a programmable logic controller does. An example of an FMU that
// drives the cell's.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "fmu/fmi/phase.h"
#include "fmu/fmi/variable_table.h"
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
struct CellState {
  bool at_destination = true;
  std::int32_t error = 0;  // of the controller
  bool gripped = false;
  PerDevice<PresenceSensor::Reading> presence;
};

/// The sequence with its inputs and outputs, as variables. All functions throw std::exception on an illegal
/// argument or call.
class Sequencer {
 public:
  /// For a cell of this layout; all steps start with the cell's own start values.
  explicit Sequencer(const CellDescription& cell);

  const fmi::VariableTable& table() const { return table_; }
  void fail() { phase_ = fmi::Phase::kFailed; }

  void setup(double start_time);
  void enter_initialization();
  void exit_initialization();
  void terminate();
  void reset();
  /// Advances by a communication step from `current`, s.
  void do_step(double current, double step);
  double last_successful_time() const { return values_.time; }

  /// T is double, std::int32_t (also for an enumeration), bool or std::string.
  template <class T>
  const T& get(std::uint32_t reference) const {
    return fmi::member<T>(typed<T>(reference));
  }
  template <class T>
  void set(std::uint32_t reference, const T& value);

 private:
  struct Values {
    explicit Values(const CellDescription& description);

    double time = 0;         // s
    std::int32_t count = 0;  // of steps that are used
    PerDevice<Step> steps;
    CellState cell;
    CellInputs command;       // of the present step
    std::int32_t number = 0;  // of the present step, counted from 1
    bool finished = false;
    std::int32_t error = 0;  // of the controller, at which the sequence stopped
    double began = 0;        // s, when the present step began
  };

  std::vector<fmi::Variable> variables(const CellLayout& layout);
  template <class T>
  const fmi::Variable& typed(std::uint32_t reference) const;
  bool is_complete(const Step& step, double communication_step) const;
  void stop(std::int32_t error);

  double cycle_;  // s, of the cell's controller
  bool has_gripper_;
  Values start_;
  Values values_;
  fmi::VariableTable table_;
  fmi::Phase phase_ = fmi::Phase::kInstantiated;
};

}  // namespace robotcell::sequencer

namespace robotcell {

template <>
inline constexpr Enumeration enumeration_of<sequencer::Until> = make_enumeration("Until",
                                                                                 sequencer::kUntilItems);

}  // namespace robotcell
