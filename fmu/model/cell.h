// The robot cell: controller, dynamics, encoders, sensors and trigger on one clock of whole microseconds.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "fmu/control/robot_controller.h"
#include "fmu/model/axes_state.h"
#include "fmu/model/cell_values.h"
#include "fmu/model/description/cell_description.h"
#include "fmu/model/devices/controller.h"
#include "fmu/model/devices/encoder.h"
#include "fmu/model/devices/sensing.h"
#include "fmu/model/devices/trigger.h"
#include "fmu/model/events.h"
#include "fmu/model/vibration.h"
#include "fmu/model/world/kinematics.h"
#include "fmu/model/world/world.h"

namespace robotcell {

/// Pose of a part at a point of the dynamics grid, relative to the frame of the tree with which it moves.
struct PartPose {
  std::size_t frame = kWorld;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
  /// m, world axes: what remains of the difference between the vibrations of the former and the present
  /// frame. The dynamics do not know vibration, so without it the true pose would jump when the frame
  /// changes.
  Eigen::Vector3d residual_displacement = Eigen::Vector3d::Zero();
};

/// State of the cell at a point of the dynamics grid.
struct GridPoint {
  explicit GridPoint(const CellLayout& layout) : readings(layout) {}

  std::int64_t time_us = 0;
  PrescribedMotion prescribed;
  AxesState true_axes;  // of the links and the table
  AxesState encoders;   // of the motors, which carry the encoders
  std::vector<PartPose> parts;
  GripperPoint gripper;
  Readings readings;
  std::int32_t solver_fallbacks = 0;    // since the start, up to the step that ends here
  std::int32_t truncated_contacts = 0;  // the same
};

/// The program that was read last.
struct LoadedProgram {
  std::string path;  // as commanded
  std::shared_ptr<const control::Program> program;
  std::string fault;  // why the segment requested last is not available; empty: it is
};

/// Complete state of a running cell.
struct CellState {
  explicit CellState(const CellLayout& layout) : from(layout), to(layout), trigger(layout) {}

  std::int64_t time_us = 0;
  GridPoint from;  // ends of the current dynamics step: from <= time <= to
  GridPoint to;
  std::vector<TimedAxes> history;  // for encoders with latency
  control::ControllerState controller;
  LoadedProgram program;
  WorldState world;
  TriggerState trigger;
  PendantCommand pendant;
};

/// Runs the dynamics on a grid of its own, independent of the communication steps. Between two grid points
/// the axes follow the cubic through positions and rates, belts have constant acceleration, and a free part
/// moves with constant velocity relative to its frame. Therefore outputs and records do not depend
/// on the communication step.
///
/// At each instant of the controller cycle the controller reads the inputs of the communication step that
/// starts or continues there. Trigger and pendant read their commands at the start of every communication
/// step.
class Cell : private MotionView {
 public:
  /// `bodies` holds the meshes of the description; relative paths of programs begin in `folder`.
  Cell(const CellDescription& description, const proximity::BodySet& bodies, const CellParameters& parameters,
       std::string folder);

  /// Called at every controller cycle within a communication step; returns the new end of the step.
  using IntermediateUpdate = std::function<std::int64_t(std::int64_t now_us, std::int64_t end_us)>;

  /// Executes a communication step with constant inputs, up to an instant (microseconds from the start), the
  /// first of the `wanted` events, or an earlier end from `intermediate`, which may be empty. Trigger and
  /// pendant read their commands at its start; at its end the next complete records, at most `max_records`,
  /// become the current one, one after the other.
  /// `start_time` (s) is the simulation time at the start of the simulation. Returns the events of the step;
  /// throws std::exception.
  Events step(const CellInputs& inputs, double start_time, std::int64_t end_us, Events wanted,
              const IntermediateUpdate& intermediate, std::size_t max_records = 1);

  std::int64_t time_us() const { return time_us_; }

  /// Number of contact problems since the start that were not solved as intended.
  std::int32_t solver_fallbacks() const { return to_.solver_fallbacks; }
  /// Number of times since the start that contacts of a pair of bodies were lost.
  std::int32_t truncated_contacts() const { return to_.truncated_contacts; }

  /// Why the controller does not execute its command, as text; empty: it does.
  std::string refusal() const;

  /// Records that became the current one at the end of a step, with `max_records` above 1: the last ones, and
  /// the number of those of the last step.
  const std::vector<TriggerRecord>& records() const { return trigger_.published(); }
  std::int32_t new_records() const { return trigger_.newly_published(); }

  /// Writes the outputs at the present instant.
  void write_outputs(CellOutputs& outputs) const;
  control::PathAhead path_ahead() const { return controller_.path_ahead(time_us_); }

  /// Pairs of bodies that intersect at the start and therefore do not touch each other, as text; empty: none.
  const std::string& intersecting_bodies() const { return world_.intersecting_bodies(); }

  CellState state() const;
  /// Throws std::invalid_argument where the state belongs to another cell.
  void restore(const CellState& state);

 private:
  void begin_step(const CellInputs& inputs, double start_time);
  bool run(const CellInputs& inputs, std::int64_t to_us, Events wanted);
  Events end_step(std::size_t max_records);
  std::int64_t next_event(Events wanted, std::int64_t to_us) const;
  control::Report report() const;

  control::Knot table(std::int64_t time_us) const override;
  SensorOnSupport sensor_on_support(std::int64_t time_us) const override;
  control::RunningSegment running_segment(std::int64_t time_us) const override;
  Measurement measurement(std::int64_t time_us) const override;
  BeltReading belt_reading(std::size_t belt, std::int64_t time_us, double lead) const override;
  void write_truth(std::int64_t time_us, Bodies& bodies) const override;

  /// Elapsed fraction of the current dynamics step at an instant, and the duration of the step (s); 1 and 0
  /// before the first step.
  double step_fraction(std::int64_t time_us) const;
  double step_duration() const;
  AxesState true_axes_at(std::int64_t time_us) const;
  AxesState encoders_at(std::int64_t time_us) const;
  void read_axes(GridPoint& point) const;
  BeltState belt_at(std::size_t belt, std::int64_t time_us) const;
  Motion finger_at(std::size_t finger, std::int64_t time_us, const Motion& flange) const;
  Motion part_at(std::size_t part, std::int64_t time_us, const Motion& carrier) const;
  /// Motions of all frames by their numbers.
  std::vector<Motion> frames_at(std::int64_t time_us) const;
  void update_frames_of_parts();
  GripperOutputs gripper_outputs() const;
  void take_commands(const CellInputs& inputs);
  std::shared_ptr<const control::ProgramSegment> requested_segment(const CellInputs& inputs);
  void step_dynamics(const CellInputs& inputs);
  void read_world();
  /// Sensor readings at the present instant.
  const Readings& readings() const;
  void read_sensors();
  std::int64_t guard_instant(double guard_time) const;

  CellDescription description_;
  std::string folder_;
  Kinematics nominal_;
  Kinematics true_;
  Encoders encoders_;
  CellVibration vibration_;
  BeltErrors belt_errors_;
  NominalArm nominal_arm_;
  control::RobotController controller_;
  LoadedProgram program_;
  World world_;
  Sensing sensing_;
  Trigger trigger_;
  PendantCommand pendant_;
  double start_time_ = 0;  // s, simulation time at the start
  std::int64_t time_us_ = 0;
  GridPoint from_;
  GridPoint to_;
  AxesHistory history_;
  bool collided_at_begin_ = false;  // at the start of the communication step
};

}  // namespace robotcell
