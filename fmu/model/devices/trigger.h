// The trigger device: fires exposures and queues their records in order.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <deque>
#include <utility>
#include <vector>

#include "fmu/control/robot_controller.h"
#include "fmu/model/bodies.h"
#include "fmu/model/devices/belt.h"
#include "fmu/model/devices/encoder.h"

namespace robotcell {

struct CellInputs;

enum class TriggerMode : std::int32_t { kOff, kTime, kTableAngle, kPathDistance, kRequest, kBeltTravel };
inline constexpr EnumerationItem kTriggerModeItems[] = {
    {"off", "no exposures"},
    {"time", "periodic in time"},
    {"table_angle", "periodic in the table angle"},
    {"path_distance", "periodic in the distance travelled by the sensor over the table"},
    {"request", "on request only"},
    {"belt_travel", "periodic in the measured travel of a belt"},
};
template <>
inline constexpr Enumeration enumeration_of<TriggerMode> = make_enumeration("TriggerMode", kTriggerModeItems);

constexpr double kMaxPathClock = 1e9;  // s: longer than any segment
constexpr double kMaxDuration = 1e9;   // s: the largest simulation time
constexpr double kMaxLightDelay = 10;  // s, of the light as built

struct TriggerCommand {
  std::int32_t mode = 0;
  double period = 0;                    // s
  double angle = 0;                     // rad
  double distance = 0;                  // m
  std::int32_t conveyor = 1;            // number of the belt, from 1
  double travel = 0;                    // m, signed
  std::int32_t request = 0;             // every increase fires one exposure
  double from = 0, to = kMaxPathClock;  // s of the path clock of a running segment

  template <class Visitor>
  static void declare(Visitor& visit, TriggerCommand& c) {
    visit(
        c,
        choice_field<TriggerMode>(
            c.mode, {"mode", kNone,
                     "Trigger mode of the sensor. Modes 1 to 3 and 5 fire when the mode is entered or "
                     "its interval is changed, and at every interval from there; modes 1 to 3 in "
                     "controller mode 6 instead when the path clock of a segment reaches "
                     "command.trigger.from"}),
        field(c.period, bounded({"period", kSecond,
                                 "Time between two exposures in trigger mode 1; at least 1 microsecond"},
                                0, kMaxDuration)),
        field(c.angle,
              bounded({"angle", kRadian,
                       "Rotation of the table, in either direction, between two exposures in trigger mode "
                       "2; above 0"},
                      0)),
        field(c.distance,
              bounded({"distance", kMetre,
                       "Path length of the sensor origin in the rotating frame of the table between two "
                       "exposures in trigger mode 3; above 0"},
                      0)),
        field(c.conveyor, {"conveyor", kNone, "Number of the conveyor of trigger mode 5, from 1"}),
        field(
            c.travel,
            {"travel", kMetre,
             "Measured travel of the belt of command.trigger.conveyor between two exposures in trigger mode "
             "5; not 0. Its sign is the direction of travel that counts: a belt that runs back and forth "
             "again triggers only beyond the farthest place that triggered"}),
        field(c.request,
              {"request", kNone, "Counter: every increase fires one exposure, in any trigger mode but 0"}),
        field(c.from, bounded({"from", kSecond,
                               "Controller mode 6: path clock of the running segment at which trigger modes "
                               "1 to 3 fire for the first time; no effect in other controller modes"},
                              0, kMaxPathClock)),
        field(c.to, bounded({"to", kSecond,
                             "Controller mode 6: path clock of the running segment up to which trigger "
                             "modes 1 to 3 fire, to 1 microsecond; no effect in other controller modes"},
                            0, kMaxPathClock)));
  }
};

struct TriggerErrors {
  double latency = 0;  // s, delay of the light against the instant that the device records
  double jitter = 0;   // s, standard deviation of that delay

  template <class Visitor>
  static void declare(Visitor& visit, TriggerErrors& e) {
    visit(
        e,
        field(
            e.latency,
            bounded(
                {"latency", kSecond,
                 "Deviation as built from nominal: mean delay of the light of an exposure after its middle, "
                 "where the encoders are latched"},
                0, kMaxLightDelay)),
        field(e.jitter,
              bounded({"jitter", kSecond,
                       "Deviation as built from nominal: standard deviation of the delay of the light from "
                       "exposure to exposure. The light never precedes the instant of firing"},
                      0, kMaxLightDelay)));
  }
};

/// Record of one exposure: encoder readings at its middle, and true poses at the instant of the light.
struct TriggerRecord {
  explicit TriggerRecord(const CellLayout& layout) : belts(layout.conveyors), truth(layout) {}

  std::int32_t index = 0;  // counted from 1; 0: no record yet
  std::int32_t segment = 0;
  double time = kNoInstant;  // middle of the exposure, s from the start
  double exposure = 0;       // s
  Measurement measured;
  PerDevice<BeltReading> belts;
  Bodies truth;

  template <class Visitor>
  static void declare(Visitor& visit, TriggerRecord& r) {
    visit(
        r,
        field(r.index,
              bounded(
                  {"index", kNone,
                   "Number of the exposure in the current record, counted from 1; 0 before the first record. "
                   "At "
                   "the end of each communication step the oldest queued record, if any, becomes the current "
                   "one"},
                  0)),
        field(r.segment,
              {"segment", kNone, "Value of command.segment when the exposure of the current record fired"}),
        field(r.time,
              instant("time",
                      "Simulation time at the middle of the exposure of the current record; 0 before the "
                      "first record")),
        field(r.exposure,
              bounded({"exposure", kSecond, "Duration of the exposure of the current record"}, 0)),
        state(r.measured, "measured"), state(r.belts, "belts"), state(r.truth, "truth"));
  }
};

/// Sensor origin in the frame that carries the part, of the table or of the flange that holds part 1, from
/// nominal geometry.
struct SensorOnSupport {
  Eigen::Vector3d position;  // m
  double speed = 0;          // m/s, in that frame
};

/// Motion of the cell as the device sees it, at any instant of the current dynamics step.
class MotionView {
 public:
  virtual ~MotionView() = default;
  virtual control::Knot table(std::int64_t time_us) const = 0;
  virtual SensorOnSupport sensor_on_support(std::int64_t time_us) const = 0;
  virtual control::RunningSegment running_segment(std::int64_t time_us) const = 0;
  virtual Measurement measurement(std::int64_t time_us) const = 0;
  /// Reading of the encoder of a belt, numbered from 0, `lead` seconds ahead at its present speed.
  virtual BeltReading belt_reading(std::size_t belt, std::int64_t time_us, double lead) const = 0;
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

/// Range of the path clock of a running segment in which modes 1 to 3 fire: not reached, reached, left.
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
  bool gated = false;  // controller mode 6 is commanded: modes 1 to 3 fire within the gate alone
  TriggerGate gate = TriggerGate::kWaiting;
  std::int32_t run = 0;  // of the segment to which the gate belongs
  double entry_angle = 0;
  double entry_travel = 0;  // m, reading of the belt
  double path = 0;          // m, path length from the start of the mode to the reference point
  std::array<double, 3> path_reference{};
  std::deque<PendingRecord> pending;  // in order of firing
  std::int32_t incomplete = 0;        // number of incomplete records
  TriggerRecord current_record;
  std::vector<TriggerRecord> published;  // those that became the current one together, where several may
  std::int32_t newly_published = 0;      // number of records at the last communication point
};

/// Intervals count from the instant at which a mode is entered or its interval changed, or at which a segment
/// of a program reaches the gate; the first exposure fires at that instant. Later ones fire at the first
/// whole microsecond at which the interval is complete. Exposures that find the queue of records full do not
/// fire. Exposures at places (table angle, path distance, belt travel, gate) fire early by half their
/// duration at the present speed, so that their middles are at the places at any speed. Belts run
/// independently of the segments of programs, so that exposures by their travel have no gate.
class Trigger {
 public:
  Trigger(const CellLayout& layout, const TriggerErrors& errors, std::uint64_t key);

  /// Reads commands at a communication point; may fire there. A mode whose interval is missing is off.
  void command(const CellInputs& inputs, std::int64_t now_us, const MotionView& view);

  /// Fires all exposures due in (from, to], and latches readings and true poses of all instants up to `to`.
  /// `step_ends` is true where `to` is on the dynamics grid.
  void advance(std::int64_t from_us, std::int64_t to_us, bool step_ends, const MotionView& view);

  /// Makes the oldest complete records the current one, one after the other, at most `max_records`; false if
  /// there is none. Where more than one is allowed, they are kept in `published`.
  bool publish(std::size_t max_records);
  const std::vector<TriggerRecord>& published() const { return state_.published; }
  /// Number of records of the last call of `publish`.
  std::int32_t newly_published() const { return state_.newly_published; }

  /// Instant at which the oldest record, pending or due in (from, to] of one dynamics step, is complete; the
  /// largest int64 if there is none.
  std::int64_t next_complete_us(std::int64_t from_us, std::int64_t to_us, const MotionView& view) const;

  const TriggerRecord& current_record() const { return state_.current_record; }
  std::int32_t count() const { return state_.count; }
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
  /// Whether the commanded mode can be carried out: a periodic one has an interval, and its belt exists.
  bool is_carried_out() const;
  /// Mode that is carried out.
  TriggerMode mode() const;
  BeltReading belt(std::int64_t time_us, const MotionView& view) const;
  bool is_full() const;
  void fire(std::int64_t time_us);
  bool fire_due(std::int64_t from_us, std::int64_t to_us, const MotionView& view);
  void latch(std::int64_t to_us, const MotionView& view);
  void skip_due(std::int64_t time_us, const MotionView& view);

  std::int64_t light_instant(std::int64_t fired_us, std::int64_t middle_us) const;

  CellLayout layout_;
  TriggerErrors errors_;
  std::uint64_t key_;
  TriggerState state_;
};

}  // namespace robotcell
