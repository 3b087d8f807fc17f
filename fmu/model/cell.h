// The robot cell: controller, dynamics, encoders and trigger on one clock of whole microseconds.
#pragma once

#include <cstdint>

#include "fmu/control/robot_controller.h"
#include "fmu/model/axes_state.h"
#include "fmu/model/cell_description.h"
#include "fmu/model/cell_values.h"
#include "fmu/model/controller_link.h"
#include "fmu/model/encoder.h"
#include "fmu/model/kinematics.h"
#include "fmu/model/senses.h"
#include "fmu/model/shaking.h"
#include "fmu/model/trigger.h"
#include "fmu/model/world.h"

namespace robotcell {

/// Where a part is at a point of the dynamics grid, in the frame of what carries it.
struct PartPose {
  Carrier carrier = Carrier::kWorld;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
};

/// A point of the dynamics grid.
struct GridPoint {
  std::int64_t time_us = 0;
  Imposed imposed;
  AxesState true_axes;  // of links and table
  AxesState encoders;   // what the motors have, and the encoders on them see
  std::vector<PartPose> parts;
  GripperPoint gripper;
  Readings readings;
};

/// What importers that handle events are told of: a bit for each source.
using Events = std::uint32_t;
constexpr Events kRecordShown = 1u << 0;
constexpr Events kCollisionChanged = 1u << 1;  // bodies began to collide, or none do any more
constexpr Events kAllEvents = ~Events{0};

/// Everything that changes while a cell runs.
struct CellState {
  explicit CellState(const CellLayout& layout) : trigger(layout) {}

  std::int64_t time_us = 0;
  GridPoint from;  // the dynamics step that holds the present: from <= time <= to
  GridPoint to;
  std::vector<TimedAxes> history;  // for encoders with latency
  control::ControllerState controller;
  ArmDynamicsState arm;
  std::vector<FreePartState> parts;
  GraspState grasp;
  TriggerState trigger;
};

/// Runs the dynamics on its own grid, whatever the communication steps are; between two grid points the axes
/// follow the cubic with the rates at both ends, belts their constant acceleration, and a free part moves
/// evenly relative to the platter or the flange that carries it, or to the world. So neither outputs nor
/// records depend on the communication step.
///
/// At an instant of the controller's cycle, the controller takes the inputs of the step that starts there.
/// The trigger device takes its commands at the start of every step.
class Cell : private MotionView {
 public:
  Cell(const CellDescription& description, const CellParameters& parameters);

  /// Opens a communication step: the trigger device takes its commands. Throws std::exception.
  void begin_step(const CellInputs& inputs);

  /// Goes on to an instant (microseconds from the start) with the inputs held, or to the first at which one
  /// of the events comes that are `wanted`. Returns where it stopped; throws std::exception.
  std::int64_t run(const CellInputs& inputs, std::int64_t to_us, Events wanted);

  /// Closes a communication step: the next finished record goes on display. Returns the step's events.
  Events end_step();

  std::int64_t time_us() const { return time_us_; }
  std::int64_t controller_cycle_us() const { return description_.controller_cycle_us; }

  /// What the cell says at the present instant.
  void write_outputs(CellOutputs& outputs) const;

  CellState state() const;
  /// Throws std::invalid_argument when the state is not of this cell.
  void restore(const CellState& state);

 private:
  std::int64_t next_event(Events wanted, std::int64_t to_us) const;

  double table_angle(std::int64_t time_us) const override;
  Eigen::Vector3d sensor_in_table(std::int64_t time_us) const override;
  Measurement measurement(std::int64_t time_us) const override;
  void write_truth(std::int64_t time_us, Bodies& bodies) const override;

  /// How much of the dynamics step that holds the present has passed at an instant, and how long it is (s):
  /// before the first step 1 and 0.
  double share_of_step(std::int64_t time_us) const;
  double step_duration() const;
  AxesState true_axes_at(std::int64_t time_us) const;
  AxesState encoders_at(std::int64_t time_us) const;
  void read_axes(GridPoint& point) const;
  control::BeltState belt_at(std::size_t belt, std::int64_t time_us) const;
  Motion finger_at(std::size_t finger, std::int64_t time_us, const Motion& flange) const;
  using Carriers = std::array<Motion, kCarriers>;
  Motion part_at(std::size_t part, std::int64_t time_us, const Carriers& carriers) const;
  void hand_over_parts();
  GripperOutputs gripper_outputs() const;
  void take_commands(const CellInputs& inputs);
  void step_dynamics(const CellInputs& inputs);
  void see_world();
  /// Those of the present instant.
  const Readings& readings() const;
  void read_sensors();

  CellDescription description_;
  Kinematics nominal_;
  Kinematics true_;
  Encoders encoders_;
  Shaking shaking_;
  NominalArm nominal_arm_;
  control::RobotController controller_;
  World world_;
  Senses senses_;
  Trigger trigger_;
  std::int64_t time_us_ = 0;
  GridPoint from_;
  GridPoint to_;
  AxesHistory history_;
  bool collided_at_begin_ = false;  // of the communication step
};

}  // namespace robotcell
