// The trigger device: fires exposures and queues their records in order.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <deque>
#include <utility>

#include "fmu/control/robot_controller.h"
#include "fmu/model/cell_values.h"

namespace robotcell {

/// Sensor origin in the rotating frame of the table, from nominal geometry.
struct SensorInTable {
  Eigen::Vector3d position;  // m
  double speed = 0;          // m/s, in that frame
};

/// Motion of the cell as the device sees it, at any instant of the current dynamics step.
class MotionView {
 public:
  virtual ~MotionView() = default;
  virtual control::Knot table(std::int64_t time_us) const = 0;
  virtual SensorInTable sensor_in_table(std::int64_t time_us) const = 0;
  virtual control::RunningSegment running_segment(std::int64_t time_us) const = 0;
  virtual Measurement measurement(std::int64_t time_us) const = 0;
  virtual void write_truth(std::int64_t time_us, Bodies& bodies) const = 0;
};

/// An exposure whose record is incomplete or not yet published. Times in microseconds from the start.
struct PendingRecord {
  explicit PendingRecord(TriggerRecord empty) : record(std::move(empty)) {}

  std::int64_t middle_us = 0;
  std::int64_t light_us = 0;  // middle plus the delay of the device as built
  bool measured = false;
  bool illuminated = false;
  TriggerRecord record;
};

/// Range of the path clock of a running segment in which periodic modes fire: not reached, reached, left.
enum class TriggerGate : std::int32_t { kWaiting, kOpen, kPassed };

/// Complete state of the device.
struct TriggerState {
  explicit TriggerState(const CellLayout& layout) : current_record(layout) {}

  TriggerCommand command;
  std::int32_t segment = 0;
  double exposure = 0;
  std::int32_t count = 0;
  std::int64_t entered_us = 0;
  std::int64_t fired_since_entry = 0;  // without requested exposures
  bool skipped = false;                // the last exposure did not fire: the queue of records was full
  bool gated = false;  // controller mode 6 is commanded: periodic modes fire within the gate alone
  TriggerGate gate = TriggerGate::kWaiting;
  std::int32_t run = 0;  // of the segment to which the gate belongs
  double entry_angle = 0;
  double path = 0;  // m, path length from the start of the mode to the reference point
  std::array<double, 3> path_reference{};
  std::deque<PendingRecord> pending;  // in order of firing
  std::int32_t incomplete = 0;        // number of incomplete records
  TriggerRecord current_record;
};

/// Intervals count from the instant at which a mode is entered or its interval changed, or at which a segment
/// of a program reaches the gate; the first exposure fires at that instant. Later ones fire at the first
/// whole microsecond at which the interval is complete. Exposures that find the queue of records full do not
/// fire. Exposures at places (table angle, path distance,
/// gate) fire early by half their duration at the present speed, so that their middles are at the places at
/// any speed.
class Trigger {
 public:
  Trigger(const CellLayout& layout, const TriggerErrors& errors, std::uint64_t key);

  /// Reads commands at a communication point; may fire there. A mode whose interval is missing is off.
  void command(const CellInputs& inputs, std::int64_t now_us, const MotionView& view);

  /// Fires all exposures due in (from, to]; `step_ends` is true where `to` is on the dynamics grid.
  void fire_until(std::int64_t from_us, std::int64_t to_us, bool step_ends, const MotionView& view);

  /// Latches readings and true poses of all instants up to and including `to`.
  void latch(std::int64_t to_us, const MotionView& view);

  /// Makes the oldest complete record the current one; false if there is none.
  bool publish_next();

  /// Instant at which the oldest pending record is complete; the largest int64 if there is none.
  std::int64_t next_complete_us() const;

  const TriggerRecord& current_record() const { return state_.current_record; }
  std::int32_t count() const { return state_.count; }
  /// Whether no record is pending.
  bool is_idle() const { return state_.pending.empty(); }
  /// Why the command is not carried out.
  control::ControllerError error() const;
  /// Number of complete records in the queue.
  std::int32_t queued() const;

  const TriggerState& state() const { return state_; }
  void restore(const TriggerState& state) { state_ = state; }

 private:
  /// Whether the next periodic exposure is due at or before an instant.
  bool is_due(std::int64_t time_us, const MotionView& view) const;
  double path_length(const Eigen::Vector3d& position) const;
  /// Path clock of the running segment at the middle of an exposure that fires at an instant.
  double path_clock(std::int64_t time_us, const MotionView& view) const;
  bool is_beyond_gate(std::int64_t time_us, const MotionView& view) const;
  bool enter_gate(std::int64_t& from_us, std::int64_t to_us, const MotionView& view);
  double lead() const;
  void restart(std::int64_t now_us, const MotionView& view);
  bool is_full() const;
  void fire(std::int64_t time_us);
  void skip_due(std::int64_t time_us, const MotionView& view);

  CellLayout layout_;
  std::int64_t light_instant(std::int64_t fired_us, std::int64_t middle_us) const;

  TriggerErrors errors_;
  std::uint64_t key_;
  TriggerState state_;
};

}  // namespace robotcell
