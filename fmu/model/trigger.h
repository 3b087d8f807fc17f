// The trigger device: decides when the sensor fires, and keeps the records of its exposures in order.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <deque>
#include <utility>

#include "fmu/model/cell_values.h"

namespace robotcell {

/// What the device sees of the motion, at any instant of the running dynamics step.
class MotionView {
 public:
  virtual ~MotionView() = default;
  virtual double table_angle(std::int64_t time_us) const = 0;
  /// Origin of the sensor in the turning frame of the table, by the nominal geometry (m).
  virtual Eigen::Vector3d sensor_in_table(std::int64_t time_us) const = 0;
  virtual Measurement measurement(std::int64_t time_us) const = 0;
  virtual void write_truth(std::int64_t time_us, Bodies& bodies) const = 0;
};

/// An exposure under way. Times in microseconds from the start.
struct PendingRecord {
  explicit PendingRecord(TriggerRecord empty) : record(std::move(empty)) {}

  std::int64_t middle_us = 0;
  std::int64_t light_us = 0;  // middle plus the as-built latency
  bool measured = false;
  bool lit = false;
  TriggerRecord record;
};

/// All that the device remembers.
struct TriggerState {
  explicit TriggerState(const CellLayout& layout) : shown(layout) {}

  TriggerCommand command;
  std::int32_t segment = 0;
  double exposure = 0;
  std::int32_t count = 0;
  std::int64_t entered_us = 0;
  std::int64_t fired_since_entry = 0;  // not counting those on request
  double entry_angle = 0;
  double path = 0;  // m travelled from entry to the reference point
  std::array<double, 3> path_reference{};
  std::deque<PendingRecord> pending;  // in the order of firing
  std::int32_t open = 0;              // how many of them still wait for an instant
  TriggerRecord shown;
};

/// Counts from the instant at which a mode is entered or its interval changed; the first exposure fires at
/// once. An instant is the first whole microsecond at which the interval is full.
class Trigger {
 public:
  /// Throws std::invalid_argument when an error makes no sense.
  Trigger(const CellLayout& layout, const TriggerErrors& errors, std::uint64_t key);

  /// Takes commands at a communication point; may fire there. Throws std::invalid_argument.
  void command(const CellInputs& inputs, std::int64_t now_us, const MotionView& view);

  /// Fires whatever falls into (from, to]; `step_ends` says that `to` is on the grid of the dynamics.
  void watch(std::int64_t from_us, std::int64_t to_us, bool step_ends, const MotionView& view);

  /// Latches the records whose instants have come, up to and including `to`.
  void latch(std::int64_t to_us, const MotionView& view);

  /// Moves the oldest finished record to the display; false if there is none.
  bool show_next();

  /// When the oldest record will be finished; the end of all time if there is none.
  std::int64_t next_ready() const;

  const TriggerRecord& shown() const { return state_.shown; }
  std::int32_t count() const { return state_.count; }
  /// Finished records that wait for the display.
  std::int32_t queued() const;

  const TriggerState& state() const { return state_; }
  void restore(const TriggerState& state) { state_ = state; }

 private:
  /// Whether the next regular exposure falls on or before an instant.
  bool due(std::int64_t time_us, const MotionView& view) const;
  double path_length(std::int64_t time_us, const MotionView& view) const;
  void enter(std::int64_t now_us, const MotionView& view);
  void fire(std::int64_t time_us);

  CellLayout layout_;
  std::int64_t light_instant(std::int64_t fired_us, std::int64_t middle_us) const;

  TriggerErrors errors_;
  std::uint64_t key_;
  TriggerState state_;
};

}  // namespace robotcell
