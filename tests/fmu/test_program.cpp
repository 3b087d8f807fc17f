// Programs: path, speed override, limits, errors.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "tests/fmu/program_model.h"

namespace {

using namespace robotcell::control;
using namespace robotcell::testing;

TEST(InterpolatedSegment, FollowsSmoothPathWithContinuousAcceleration) {
  const auto segment = waves(3.2);
  EXPECT_NEAR(segment->duration(), 3.2, 1e-12);
  double error = 0;
  for (double t = 0; t < 3.2; t += 1e-3) {
    const Knots knots = segment->at(t);
    for (std::size_t i = 0; i < kArmJoints; ++i) {
      error = std::max(error, std::abs(knots[i].position - wave(i, t, 3.2)));
      const double ahead = segment->at(t + 1e-5)[i].position;
      const double behind = segment->at(std::max(0.0, t - 1e-5))[i].position;
      if (t > 0) {
        EXPECT_NEAR(knots[i].velocity, (ahead - behind) / 2e-5, 1e-4);
      }
    }
  }
  EXPECT_LT(error, 1e-6);
  for (std::size_t k = 1; k + 1 < segment->knots.size(); ++k) {
    const Knot &before = segment->knots[k - 1][0], &here = segment->knots[k][0],
               &after = segment->knots[k + 1][0];
    const double end =
        2 * before.velocity + 4 * here.velocity - 6 * (here.position - before.position) / kCycleSeconds;
    const double start =
        6 * (after.position - here.position) / kCycleSeconds - 4 * here.velocity - 2 * after.velocity;
    EXPECT_NEAR(end, start, 1e-9);
  }
}

TEST(InterpolatedSegment, OfTwoPointsIsOneCubic) {
  Axes to = home();
  to[0] += 1e-3;
  const ProgramSegment segment = interpolated_segment(1, kCycleSeconds, {home(), to});
  EXPECT_NEAR(segment.at(kCycleSeconds / 2)[0].position, home()[0] + 5e-4, 1e-15);
  EXPECT_EQ(segment.at(1)[0].position, to[0]);
}

TEST(Program, AtFullSpeedReachesSetPointsInTheirCycles) {
  Drive drive;
  const auto segment = waves(3.2);
  start(drive, segment);
  for (std::size_t k = 1; k < segment->knots.size(); ++k) {
    drive.run(1);
    const Report report = drive.controller.report(drive.now);
    EXPECT_NEAR(report.path_clock.clock, static_cast<double>(k) * kCycleSeconds, 1e-12);
    for (std::size_t i = 0; i < kAxes; ++i) {
      EXPECT_NEAR(drive.position()[i], segment->knots[k][i].position, 1e-12);
    }
  }
  const Report report = drive.controller.report(drive.now);
  EXPECT_EQ(drive.position(), segment->end());
  EXPECT_TRUE(report.at_destination);
  EXPECT_EQ(report.progress, 1);
  EXPECT_EQ(report.destination, segment->end());
}

TEST(Program, RandomOverrideKeepsPathAndAccelerationLimits) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> speed(0.1, 1.0);
    std::uniform_int_distribution<int> cycles(6, 62);
    Drive drive;
    const auto segment = waves(3.2);
    start(drive, segment);
    LimitWatch watch(drive);
    double off_path = 0, clock = 0, rate = 1;
    std::int64_t time = 0;
    while (!drive.controller.report(drive.now).at_destination || drive.now == 0) {
      drive.command.monitor_speed = speed(random);
      for (int k = cycles(random); k > 0 && (time == 0 || drive.controller.report(time).moving); --k) {
        drive.run(1, [&](const Knots& knots) {
          watch(knots);
          time += 1000;
          const ClockPoint point = drive.controller.report(time).path_clock;
          EXPECT_GE(point.clock, clock);
          EXPECT_LE(point.clock - clock, 1e-3 * (1 + 1e-9));
          EXPECT_LE(std::abs(point.rate - rate), time > 1000 && point.clock < 3.19 ? 4.001e-3 : 1);
          clock = point.clock;
          rate = point.rate;
          const Knots expected = segment->at(point.clock);
          for (std::size_t i = 0; i < kAxes; ++i) {
            off_path = std::max(off_path, std::abs(knots[i].position - expected[i].position));
          }
        });
      }
      ASSERT_LT(drive.now, 60'000'000);
    }
    EXPECT_LT(off_path, 2e-6) << "rad, between two cycles";
    EXPECT_LE(watch.acceleration, 1);
    EXPECT_GT(watch.acceleration, 0.5);
    EXPECT_EQ(drive.position(), segment->end());
  }
}

TEST(Program, PausesOnItsPathAndGoesOn) {
  Drive drive;
  const auto segment = waves(3.2);
  start(drive, segment);
  drive.run(60);
  drive.command.monitor_speed = 0;
  drive.run(60);
  const Report paused = drive.controller.report(drive.now);
  EXPECT_FALSE(paused.moving);
  EXPECT_EQ(paused.path_clock.rate, 0);
  EXPECT_EQ(paused.mode, Mode::kProgram);
  for (std::size_t i = 0; i < kAxes; ++i) {
    EXPECT_NEAR(drive.position()[i], segment->at(paused.path_clock.clock)[i].position, 1e-12);
  }
  drive.command.monitor_speed = 1;
  drive.run(1);
  drive.run_to_rest();
  EXPECT_EQ(drive.position(), segment->end());
}

TEST(Program, SegmentThatCannotBeExecutedDoesNotStart) {
  const auto expect_error = [](std::shared_ptr<const ProgramSegment> segment, ControllerError error,
                               std::int32_t axis) {
    Drive drive;
    start(drive, std::move(segment));
    drive.run(20);
    EXPECT_EQ(drive.position(), home());
    EXPECT_EQ(drive.controller.report(drive.now).error, error);
    EXPECT_EQ(drive.controller.report(drive.now).limit, axis);
    start(drive, waves(3.2));
    drive.run(20);
    EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kNone);
    EXPECT_TRUE(drive.controller.report(drive.now).moving);
  };
  expect_error(nullptr, ControllerError::kNoSegment, 0);
  expect_error(waves(3.2, 0.01), ControllerError::kElsewhere, 1);
  expect_error(waves(1.0), ControllerError::kTooFast, 1);
  expect_error(straight(5, 6.3 - home()[5] + 0.1, 3), ControllerError::kTargetOutOfLimits, 6);
  expect_error(straight(5, std::numeric_limits<double>::quiet_NaN(), 1), ControllerError::kElsewhere, 6);
}

TEST(Program, NewStartStopsRunningSegmentOnItsPathFirst) {
  Drive drive;
  const auto segment = waves(3.2);
  start(drive, segment);
  drive.run(80);
  start(drive, segment);
  LimitWatch watch(drive);
  drive.run_to_rest(watch);
  drive.run(2);
  EXPECT_LE(watch.acceleration, 1);
  EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kElsewhere);
}

TEST(PathAhead, IsWhereProgramMoveAndLineWillBe) {
  for (const Mode mode : {Mode::kProgram, Mode::kJointMove, Mode::kLineMove}) {
    Drive drive;
    if (mode == Mode::kProgram) {
      start(drive, waves(3.2));
    } else if (mode == Mode::kJointMove) {
      Axes target = home();
      for (std::size_t i = 0; i < kAxes; ++i) target[i] += 0.3;
      drive.start_joints(target);
    } else {
      Eigen::Isometry3d target = drive.arm.tool(home()).pose;
      target.pretranslate(Eigen::Vector3d(0.1, -0.2, 0.1));
      drive.start_line(target);
    }
    drive.run(10);
    const PathAhead ahead = drive.controller.path_ahead(drive.now);
    for (std::size_t k = 0; k < ahead.size(); ++k) {
      for (std::size_t i = 0; i < kAxes; ++i) EXPECT_NEAR(drive.position()[i], ahead[k][i], 1e-10);
      drive.run(1);
    }
    drive.run_to_rest();
    drive.run(1);
    for (const Axes& point : drive.controller.path_ahead(drive.now)) EXPECT_EQ(point, drive.position());
  }
}

}  // namespace
