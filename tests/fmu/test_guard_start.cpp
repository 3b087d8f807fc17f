// Start of programmed motions with a guard: nothing moves on a path that no answered state has shown.
#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <random>

#include "tests/fmu/program_model.h"

namespace {

using namespace robotcell::control;
using namespace robotcell::testing;

constexpr double kStartMaxAge = 0.4;
constexpr Mode kMotions[] = {Mode::kJointMove, Mode::kLineMove, Mode::kProgram};

Axes elsewhere() {
  Axes target = home();
  for (std::size_t i = 0; i < kAxes; ++i) target[i] += 0.3;
  return target;
}

void start(Drive& drive, Mode mode) {
  Eigen::Isometry3d target = drive.arm.tool(home()).pose;
  target.pretranslate(Eigen::Vector3d(0.05, -0.1, 0.1));
  if (mode == Mode::kJointMove) drive.start_joints(elsewhere());
  if (mode == Mode::kLineMove) drive.start_line(target);
  if (mode == Mode::kProgram) robotcell::testing::start(drive, straight(0, 0.8, 2));
}

/// A drive at home whose guard has answered the state of the present instant.
class GuardedStart : public ::testing::TestWithParam<Mode> {
 protected:
  GuardedStart() {
    drive_.command.guard_max_age = kStartMaxAge;
    answered(5);
    answer();
  }
  void answer() { drive_.command.guard_us = drive_.now; }
  void answered(int cycles) {
    for (int k = 0; k < cycles; ++k) {
      answer();
      drive_.run(1);
    }
  }
  Report report() const { return drive_.controller.report(drive_.now); }

  Drive drive_;
};

INSTANTIATE_TEST_SUITE_P(Motions, GuardedStart, ::testing::ValuesIn(kMotions));

TEST_P(GuardedStart, WaitsInViewUntilAStateThatShowsThePathIsAnswered) {
  start(drive_, GetParam());
  const std::int64_t taken_up = drive_.now;  // as the last answered state was measured: it shows no path
  drive_.run(10);
  EXPECT_EQ(drive_.position(), home());
  EXPECT_TRUE(report().guard_waits);
  EXPECT_EQ(report().path_us, taken_up);
  EXPECT_FALSE(report().moving);
  EXPECT_FALSE(report().at_destination);
  EXPECT_EQ(report().phase, Phase::kRest);
  EXPECT_EQ(report().mode, GetParam());
  EXPECT_EQ(report().error, ControllerError::kNone);
  EXPECT_EQ(report().path_clock.clock, 0);
  EXPECT_EQ(report().path_clock.rate, 0);
  EXPECT_EQ(drive_.controller.running_segment(drive_.now).run, 0);
  const PathAhead ahead = drive_.controller.path_ahead(drive_.now);
  EXPECT_EQ(ahead.front(), home());
  EXPECT_NE(ahead.back(), home());

  drive_.command.guard_us = taken_up + 1;
  drive_.run(1);
  EXPECT_TRUE(report().moving);
  EXPECT_FALSE(report().guard_waits);
  EXPECT_EQ(report().path_us, taken_up);
  EXPECT_EQ(drive_.controller.running_segment(drive_.now).run, GetParam() == Mode::kProgram ? 1 : 0);
  for (std::size_t k = 1; k < ahead.size(); ++k) {  // it is where the waiting path said
    for (std::size_t i = 0; i < kAxes; ++i) EXPECT_NEAR(drive_.position()[i], ahead[k][i], 1e-10);
    answered(1);
  }
}

/// A move of 1e-5 rad, shorter than a cycle, differs from its start in what is shown.
TEST(GuardedMove, ShowsAMoveThatIsShorterThanACycle) {
  Drive drive;
  drive.command.guard_max_age = kStartMaxAge;
  Axes target = home();
  target[1] += 1e-5;
  drive.start_joints(target);
  drive.run(1);
  const PathAhead ahead = drive.controller.path_ahead(drive.now);
  EXPECT_TRUE(drive.controller.report(drive.now).guard_waits);
  EXPECT_EQ(ahead.front(), home());
  EXPECT_EQ(ahead[1], target);
}

TEST(GuardedServo, IsRejected) {
  Drive drive;
  drive.command.guard_max_age = kStartMaxAge;
  drive.command.mode = Mode::kServo;
  drive.command.position = home();
  drive.command.position[1] += 0.1;
  drive.run(10);
  EXPECT_EQ(drive.position(), home());
  EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kGuardedServo);
  drive.command.guard_max_age = 0;
  drive.run(10);
  EXPECT_NE(drive.position(), home());
}

TEST_P(GuardedStart, GoesOnAsWithoutAGuardAfterTheWait) {
  Drive free;
  free.command.monitor_speed = drive_.command.monitor_speed = 0.7;
  start(free, GetParam());
  start(drive_, GetParam());
  drive_.run(3);
  for (int k = 0; k < 250; ++k) {
    answered(1);
    free.run(1);
    ASSERT_EQ(drive_.position(), free.position()) << k;
  }
  EXPECT_TRUE(report().at_destination);
}

TEST_P(GuardedStart, AnswersToEarlierStatesDoNotLetItGo) {
  drive_.command.guard_us = 0;
  drive_.run(2);
  start(drive_, GetParam());
  const std::int64_t taken_up = drive_.now;
  for (std::int64_t state = taken_up - 4 * kCycle; state <= taken_up; state += kCycle) {
    drive_.command.guard_us = state;
    drive_.run(1);
    EXPECT_EQ(drive_.position(), home());
    EXPECT_TRUE(report().guard_waits);
  }
}

TEST_P(GuardedStart, EndsWhereItIsStoppedOrReplacedWhileItWaits) {
  start(drive_, GetParam());
  drive_.run(2);
  drive_.command.emergency_stop = true;
  drive_.run(1);
  EXPECT_FALSE(report().guard_waits);
  EXPECT_EQ(report().phase, Phase::kEmergencyStop);
  drive_.command.emergency_stop = false;
  drive_.command.mode = Mode::kHold;
  ++drive_.command.reset;
  answered(10);
  EXPECT_EQ(drive_.position(), home());
  EXPECT_EQ(report().error, ControllerError::kNone);

  start(drive_, GetParam());
  answered(1);
  drive_.start_joints(home());  // nothing to go: nothing to wait for
  drive_.run(1);
  EXPECT_FALSE(report().guard_waits);
  EXPECT_TRUE(report().at_destination);
}

TEST_P(GuardedStart, WhereTheGuardFallsSilentItNeedsAResetAndAnAnswer) {
  start(drive_, GetParam());
  drive_.run(40);
  EXPECT_EQ(report().error, ControllerError::kGuardTimeout);
  ++drive_.command.reset;
  answered(20);  // the first answer comes with the reset
  EXPECT_EQ(report().error, ControllerError::kNone);
  EXPECT_TRUE(report().moving);
}

TEST_F(GuardedStart, ANewPathWaitsWhereTheOldOneEndsAndIsThenShown) {
  start(drive_, Mode::kJointMove);
  answered(15);
  const std::int64_t first = report().path_us;
  ++drive_.command.start;
  drive_.command.position = home();
  drive_.run(1);
  EXPECT_TRUE(report().moving);
  EXPECT_EQ(report().path_us, first) << "it brakes on its path";
  LimitWatch watch(drive_);
  int cycles = 0;
  for (; report().path_us == first && cycles < 20; ++cycles) {
    drive_.command.guard_us = drive_.now - kCycle;
    drive_.run(1, watch);
  }
  EXPECT_GT(cycles, 1);
  EXPECT_LE(watch.acceleration, 1);
  const Axes stood = drive_.position();
  drive_.run(4);
  EXPECT_EQ(drive_.position(), stood);
  EXPECT_TRUE(report().guard_waits);
  EXPECT_LT(drive_.controller.path_ahead(drive_.now).back()[0], stood[0]);
  answered(150);
  EXPECT_EQ(drive_.position(), home());
}

TEST_F(GuardedStart, AMonitorSpeedOfZeroHoldsItAtItsStart) {
  drive_.command.monitor_speed = 0;
  start(drive_, Mode::kProgram);
  answered(5);
  EXPECT_FALSE(report().guard_waits);
  EXPECT_EQ(drive_.position(), home());
  drive_.command.monitor_speed = 0.6;
  answered(1);
  EXPECT_NEAR(report().path_clock.rate, 0.6, 1e-12);
}

/// Random moves, given at any time, with states that are answered late, out of order, or never.
TEST(GuardedMoves, NothingMovesOnAPathThatNoAnsweredStateHasShown) {
  std::mt19937 random(7);
  Drive drive;
  drive.command.guard_max_age = kStartMaxAge;
  std::uniform_real_distribution<double> uniform;
  std::deque<std::pair<std::int64_t, std::int64_t>> answers;  // arrival, state
  std::int64_t newest = 0;
  int moved = 0, waited = 0;
  for (int k = 0; k < 20'000; ++k) {
    if (uniform(random) < 0.02) {
      Axes target = home();
      for (double& angle : target) angle += uniform(random) - 0.5;
      drive.start_joints(target);
    }
    if (drive.controller.report(drive.now).error == ControllerError::kGuardTimeout) ++drive.command.reset;
    drive.command.monitor_speed = uniform(random) < 0.01 ? uniform(random) : drive.command.monitor_speed;
    if (k % 2 == 0 && uniform(random) < 0.9) {
      answers.emplace_back(drive.now + static_cast<std::int64_t>(120'000 * uniform(random)), drive.now);
    }
    for (auto answer = answers.begin(); answer != answers.end();) {
      const bool arrives = answer->first <= drive.now;
      if (arrives) drive.command.guard_us = answer->second;
      if (arrives) newest = std::max(newest, answer->second);
      answer = arrives ? answers.erase(answer) : answer + 1;
    }
    const std::int64_t from_us = drive.controller.report(drive.now).path_us;
    const Axes from = drive.position();
    drive.run(1);
    const Report report = drive.controller.report(drive.now);
    const bool moves = drive.position() != from;
    ASSERT_TRUE(!moves || newest > from_us || report.path_us != from_us) << k;
    ASSERT_TRUE(!moves || newest > report.path_us) << k;
    ASSERT_TRUE(!report.guard_waits || newest <= report.path_us) << k;
    moved += moves;
    waited += report.guard_waits;
  }
  EXPECT_GT(moved, 4000);
  EXPECT_GT(waited, 500);
}

}  // namespace
