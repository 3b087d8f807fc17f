// Stops: by the age of the guard's messages, and by emergency stop in every mode.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "tests/fmu/program_model.h"

namespace {

using namespace robotcell::control;
using namespace robotcell::testing;

constexpr double kStopMaxAge = 0.8;

/// Joint 1 at 0.5 rad/s in a program, with a message of the guard in every cycle.
class GuardTest : public ::testing::Test {
 protected:
  GuardTest() {
    drive_.command.guard_max_age = kStopMaxAge;
    start(drive_, segment_);
    feed(60);
  }
  void feed(int cycles) {
    for (int k = 0; k < cycles; ++k) {
      drive_.command.guard_us = drive_.now;
      drive_.run(1);
    }
  }
  Report report() const { return drive_.controller.report(drive_.now); }

  std::shared_ptr<const ProgramSegment> segment_ = straight(0, 1.5, 3);
  Drive drive_;
};

TEST_F(GuardTest, SpeedFollowsAgeToGuaranteedStop) {
  const std::int64_t answered = drive_.command.guard_us;
  std::int64_t time = drive_.now;
  double travel = -drive_.position()[0];
  LimitWatch watch(drive_);
  drive_.run(60, [&](const Knots& knots) {
    watch(knots);
    time += 1000;
    const double age = static_cast<double>(time - answered) * 1e-6;
    const double share = std::clamp(2 - 2 * age / kStopMaxAge, 0.0, 1.0);
    // Within a cycle the speed changes linearly: at the two corners it differs by half a cycle's change.
    const double tolerance = 2 / kStopMaxAge * kCycleSeconds / 2;
    EXPECT_NEAR(drive_.controller.report(time).path_clock.rate, share, tolerance) << age;
    if (age >= kStopMaxAge + kCycleSeconds) {
      EXPECT_EQ(knots[0].velocity, 0);
    }
  });
  travel += drive_.position()[0];
  // From the first cycle without message: full speed for half the age, then the triangle; one cycle is gone.
  const double closed_form = 0.5 * (0.75 * kStopMaxAge - kCycleSeconds);
  EXPECT_NEAR(travel, closed_form, 0.5 * 2 / kStopMaxAge * kCycleSeconds * kCycleSeconds);
  EXPECT_LE(watch.acceleration, 1);
  EXPECT_EQ(report().error, ControllerError::kGuardTimeout);
  EXPECT_EQ(report().mode, Mode::kProgram);
  EXPECT_NEAR(drive_.position()[0], segment_->at(report().path_clock.clock)[0].position, 1e-12);
}

TEST_F(GuardTest, GoesOnOnlyAfterResetWithFreshMessage) {
  drive_.run(60);
  const Axes stopped = drive_.position();
  ++drive_.command.reset;  // too old
  drive_.run(10);
  EXPECT_EQ(drive_.position(), stopped);
  feed(10);
  EXPECT_EQ(drive_.position(), stopped) << "a message alone does not restart the motion";
  EXPECT_EQ(report().error, ControllerError::kGuardTimeout);
  ++drive_.command.start;
  feed(10);
  EXPECT_EQ(drive_.position(), stopped);
  ++drive_.command.reset;
  LimitWatch watch(drive_);
  for (int k = 0; k < 300; ++k) {
    drive_.command.guard_us = drive_.now;
    drive_.run(1, watch);
  }
  EXPECT_LE(watch.acceleration, 1);
  EXPECT_EQ(report().error, ControllerError::kNone);
  EXPECT_EQ(drive_.position(), segment_->end());
}

TEST_F(GuardTest, RecoversWithoutResetBeforeTheStop) {
  drive_.run(38);
  EXPECT_LT(report().path_clock.rate, 0.6);
  EXPECT_EQ(report().error, ControllerError::kNone);
  feed(40);
  EXPECT_EQ(report().path_clock.rate, 1);
}

TEST_F(GuardTest, IgnoresTimesInTheFutureAndOlderOnes) {
  const std::int64_t answered = drive_.command.guard_us;
  drive_.command.guard_us = drive_.now + 10'000'000;
  drive_.run(20);
  drive_.command.guard_us = 0;
  drive_.run(40);
  EXPECT_NEAR(report().guard_age, static_cast<double>(drive_.now - answered) * 1e-6, 1e-9);
  EXPECT_EQ(report().error, ControllerError::kGuardTimeout);
}

TEST_F(GuardTest, ShortAgeBrakesAtAccelerationLimit) {
  Drive drive;
  drive.command.guard_max_age = 0.032;
  start(drive, straight(kTableAxis, 5.4, 3));  // 1.8 rad/s, limit 6 rad/s^2
  for (int k = 0; k < 60; ++k) {
    drive.command.guard_us = drive.now;
    drive.run(1);
  }
  const double from = drive.position()[kTableAxis];
  LimitWatch watch(drive);
  drive.run_to_rest(watch);
  const double closed_form = 1.8 * 1.8 / (2 * 6);
  EXPECT_LE(watch.acceleration, 1);
  EXPECT_GE(drive.position()[kTableAxis] - from, closed_form);
  EXPECT_LE(drive.position()[kTableAxis] - from, closed_form + 2 * 1.8 * kCycleSeconds);
}

TEST(GuardWatchdog, JogsEndInEmergencyStop) {
  for (const Mode mode : {Mode::kJointJog, Mode::kCartesianJog}) {
    Drive drive;
    drive.command.mode = mode;
    drive.command.operation = Operation::kManual;
    drive.command.guard_max_age = 0.1;
    drive.command.jog[0] = 1;
    for (int k = 0; k < 40; ++k) {
      drive.command.guard_us = drive.now;
      drive.run(1);
    }
    EXPECT_TRUE(drive.controller.report(drive.now).moving);
    EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kNone);
    LimitWatch watch(drive);
    for (int k = 0; k < 40; ++k) {
      drive.run(1, watch);
    }
    EXPECT_LE(watch.acceleration, 1);
    EXPECT_EQ(drive.controller.report(drive.now).phase, Phase::kEmergencyStop);
    EXPECT_TRUE(drive.controller.report(drive.now).guard_stopped);
    const Axes stopped = drive.position();
    drive.command.guard_us = drive.now;
    drive.run(10);
    EXPECT_EQ(drive.position(), stopped);
    drive.command.mode = Mode::kHold;
    ++drive.command.reset;
    drive.run(1);
    EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kNone);
  }
}

/// Brings joint 1 to a constant speed (rad/s) in a mode; returns the speed.
double run_joint_1(Drive& drive, Mode mode) {
  drive.command.mode = mode;
  Axes target = home();
  target[0] += 2;
  switch (mode) {
    case Mode::kProgram:
      start(drive, straight(0, 2, 2));
      drive.run(60);
      return 1;
    case Mode::kJointMove:
      drive.command.speed = 0.2;
      drive.start_joints(target);
      drive.run(60);
      return 0.999;
    case Mode::kServo:
      for (int k = 0; k < 60; ++k) {
        drive.command.position[0] += 0.016;
        drive.run(1);
      }
      return 1;
    default:
      drive.command.operation = Operation::kManual;
      drive.command.jog[0] = 1;
      drive.run(60);
      return std::abs(drive.controller.sample(drive.now)[0].velocity);
  }
}

TEST(EmergencyStop, TravelIsThatOfConstantDecelerationInEveryMode) {
  for (const Mode mode : {Mode::kServo, Mode::kJointMove, Mode::kJointJog, Mode::kProgram}) {
    Drive drive;
    const double speed = run_joint_1(drive, mode);
    ASSERT_NEAR(std::abs(drive.controller.sample(drive.now)[0].velocity), speed, 1e-3 * speed);
    const double from = drive.position()[0];
    drive.command.emergency_stop = true;
    LimitWatch watch(drive);
    drive.run_to_rest(watch);
    const double closed_form = speed * speed / (2 * 20);
    const double travel = std::abs(drive.position()[0] - from);
    EXPECT_LE(watch.acceleration, 1) << static_cast<int>(mode);
    EXPECT_GE(travel, 0.999 * closed_form) << static_cast<int>(mode);
    // A cycle that is not fully used to brake, and the margin of 0.1 % for rounding.
    EXPECT_LE(travel, 1.002 * closed_form + speed * kCycleSeconds / 2) << static_cast<int>(mode);
    drive.command.emergency_stop = false;
    const Axes stopped = drive.position();
    drive.run(20);
    EXPECT_EQ(drive.position(), stopped);
  }
}

TEST(EmergencyStop, ProgramStopsOnItsPathWithinLimits) {
  Drive drive;
  const auto segment = waves(3.2);
  start(drive, segment);
  drive.run(100);
  drive.command.emergency_stop = true;
  LimitWatch watch(drive);
  drive.run_to_rest(watch);
  EXPECT_LE(watch.acceleration, 1);
  const double clock = drive.controller.report(drive.now).path_clock.clock;
  for (std::size_t i = 0; i < kAxes; ++i) {
    EXPECT_NEAR(drive.position()[i], segment->at(clock)[i].position, 1e-12);
  }
}

TEST(EmergencyStop, AxisBrakesAloneWhereProportionalBrakingWouldPassItsLimit) {
  Drive drive;
  drive.command.mode = Mode::kServo;
  const double speed = 2.5;
  const auto cycles = static_cast<int>((6.3 - 0.25 - home()[5]) / (speed * kCycleSeconds));
  for (int k = 0; k < cycles; ++k) {
    drive.command.position[5] += speed * kCycleSeconds;
    drive.command.position[kTableAxis] += speed * kCycleSeconds;
    drive.run(1);
  }
  drive.command.emergency_stop = true;
  LimitWatch watch(drive);
  drive.run_to_rest(watch);
  // The table needs 0.42 s, in which joint 6 would travel 0.52 rad; alone it stops within 0.16 rad.
  EXPECT_LE(watch.acceleration, 1 + 1e-9);
  EXPECT_TRUE(watch.inside);
  EXPECT_LT(drive.position()[5], 6.3);
}

}  // namespace
