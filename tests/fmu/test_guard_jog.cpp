// Jogs with a guard: the robot moves by hand only where an answered state has shown it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <random>
#include <vector>

#include "tests/fmu/arm_model.h"

namespace {

using namespace robotcell::control;
using namespace robotcell::testing;

constexpr double kMaxAge = 0.12;
// A robot that stops when another mode is commanded leaves a bent path along its tangent, in some six cycles.
constexpr double kOnTangent = 6.0 * 6.0 / 2 * 4;
constexpr Mode kJogs[] = {Mode::kJointJog, Mode::kCartesianJog};

/// A drive at home in manual operation whose guard has answered the state of the present instant.
class GuardedJog : public ::testing::TestWithParam<Mode> {
 protected:
  GuardedJog() {
    drive_.command.operation = Operation::kManual;
    drive_.command.guard_max_age = kMaxAge;
    drive_.command.mode = GetParam();
    answered(5);
  }
  /// Cycles whose states are answered at once.
  void answered(int cycles) {
    for (int k = 0; k < cycles; ++k) {
      drive_.command.guard_us = drive_.now;
      drive_.run(1);
    }
  }
  bool waits() const { return drive_.controller.report(drive_.now).guard_waits; }
  bool moving() const { return drive_.controller.report(drive_.now).moving; }
  PathAhead ahead() const { return drive_.controller.path_ahead(drive_.now); }
  double rate() const { return drive_.controller.report(drive_.now).rate; }
  double speed() const { return drive_.controller.sample(drive_.now)[1].velocity; }
  double tool_speed() const {
    Axes later = drive_.position();
    for (std::size_t i = 0; i < kAxes; ++i)
      later[i] += 1e-6 * drive_.controller.sample(drive_.now)[i].velocity;
    const auto at = [this](const Axes& axes) -> Eigen::Vector3d {
      return drive_.arm.tool(axes).pose.translation();
    };
    return (at(later) - at(drive_.position())).norm() / 1e-6;
  }

  Drive drive_;
};

INSTANTIATE_TEST_SUITE_P(Jogs, GuardedJog, ::testing::ValuesIn(kJogs));

TEST_P(GuardedJog, WaitsAtRestUntilAStateThatShowsItIsAnswered) {
  EXPECT_EQ(ahead().back(), home());
  drive_.command.jog[1] = 0.5;
  drive_.command.guard_us = drive_.now;  // measured before the controller reads the jog
  drive_.run(5);
  EXPECT_EQ(drive_.position(), home());
  EXPECT_TRUE(waits());
  EXPECT_NE(ahead().back(), home());
  drive_.command.guard_us = drive_.now;
  drive_.run(1);
  EXPECT_FALSE(waits());
  EXPECT_TRUE(moving());
}

TEST_P(GuardedJog, MonitorSpeedZeroLetsNoJogBeginAndStopsOne) {
  drive_.command.monitor_speed = 0;
  drive_.command.jog[1] = 0.5;
  answered(10);
  EXPECT_EQ(drive_.position(), home());
  drive_.command.monitor_speed = 1e-3;
  answered(3);
  EXPECT_TRUE(moving());
  drive_.command.monitor_speed = 0;
  answered(20);
  EXPECT_FALSE(moving());
  EXPECT_NE(drive_.position(), home());
  EXPECT_NE(drive_.controller.report(drive_.now).phase, Phase::kEmergencyStop);
}

TEST_P(GuardedJog, SpeedIsTheSmallerOfDeflectionAndMonitorSpeedWithoutAnotherAnswer) {
  const double cases[][2] = {{1, 0.6}, {0.1, 1}, {1, 0.3}, {0.2, 0.3}, {1, 0.05}};
  for (const auto& [deflection, monitor_speed] : cases) {
    drive_.command.jog[1] = deflection;
    drive_.command.monitor_speed = monitor_speed;
    answered(2);  // the first one shows the jog
    drive_.command.guard_max_age = 10;
    drive_.run(30);
    const double share = std::min(deflection, monitor_speed);
    EXPECT_NEAR(rate(), share, 1e-6 * share) << deflection;
    if (GetParam() == Mode::kJointJog) {
      EXPECT_NEAR(speed(), share * settings().jog.joint_share * settings().motion.axes[1].max_speed, 1e-9);
    } else {
      EXPECT_NEAR(tool_speed(), share * settings().jog.line_speed, 1e-3 * share);
    }
  }
}

TEST_P(GuardedJog, MonitorSpeedIsAShareOfTheSpeedToWhichTheToolLimitsAJog) {
  drive_.command.jog[0] = drive_.command.jog[1] = drive_.command.jog[2] = 1;
  drive_.command.monitor_speed = 0.5;
  answered(20);
  EXPECT_NEAR(rate(), 0.5, 0.01);
  drive_.command.jog[0] = drive_.command.jog[1] = drive_.command.jog[2] = 0.9;
  answered(5);
  EXPECT_NEAR(rate(), 0.5, 0.01);
}

TEST_P(GuardedJog, ReversesAtRest) {
  drive_.command.jog[1] = 1;
  answered(20);
  const double fast = speed();
  drive_.command.jog[1] = -1;
  bool rested = false;
  for (int k = 0; k < 100 && !rested; ++k) {
    answered(1);
    ASSERT_GE(speed() * fast, 0) << "no reversal before the axes rest";
    rested = speed() == 0;
  }
  EXPECT_TRUE(rested);
  answered(20);
  EXPECT_LT(speed() * fast, 0);
}

TEST_P(GuardedJog, ShowsTheSamePathAtAnyDeflectionAndNoneAfterItsRelease) {
  drive_.command.guard_us = -1;  // it waits for an answer
  drive_.command.jog[1] = 1;
  drive_.run(1);
  const PathAhead full = ahead();
  drive_.command.jog[1] = 0.01;
  drive_.run(1);
  EXPECT_EQ(ahead(), full);
  answered(10);
  EXPECT_GT(rate(), 0);
  drive_.command.jog[1] = 0;
  answered(20);
  EXPECT_EQ(rate(), 0);
  EXPECT_EQ(ahead().back(), drive_.position());
}

TEST_P(GuardedJog, PathIsShownAtFourTimesTheDeflectionAtLeastATwentieth) {
  const double cases[][2] = {{0.001, 0.05}, {0.01, 0.05}, {0.1, 0.4}, {0.3, 1}, {1, 1}};
  for (const auto& [deflection, shown] : cases) {
    drive_.command.jog[1] = 0;
    answered(20);
    drive_.command.jog[1] = deflection;
    drive_.command.guard_max_age = 10;
    answered(2);
    drive_.run(30);
    drive_.command.guard_max_age = kMaxAge;
    EXPECT_NEAR(rate(), deflection / shown, 1e-3 * deflection / shown) << deflection;
  }
}

TEST_P(GuardedJog, FasterJogIsShownAnewAndKeepsItsSpeedUntilThatIsAnswered) {
  drive_.command.jog[1] = 0.1;
  drive_.command.guard_max_age = 10;
  answered(2);
  drive_.run(20);
  const auto fast = [this] { return GetParam() == Mode::kJointJog ? std::abs(speed()) : tool_speed(); };
  const auto travel = [this, &fast] { return fast() / rate(); };  // of the path ahead, in a second
  const double slow = fast(), shown = travel();
  EXPECT_FALSE(waits());
  drive_.command.jog[1] = 0.3;  // within what is shown
  drive_.run(30);
  EXPECT_NEAR(travel(), shown, 0.05 * shown);
  EXPECT_NEAR(fast(), 3 * slow, 0.05 * slow);
  drive_.command.jog[1] = 0.5;
  for (int k = 0; k < 20; ++k) {
    drive_.run(1);
    EXPECT_TRUE(waits());
    EXPECT_NEAR(travel(), 2.5 * shown, 0.1 * shown);
    EXPECT_NEAR(fast(), 3 * slow, 0.1 * slow);
  }
  answered(1);
  drive_.run(30);
  EXPECT_NEAR(fast(), 5 * slow, 0.1 * slow);
}

TEST_P(GuardedJog, SpeedOfAPathThatIsShownAnewIsReportedBeforeItIsReached) {
  drive_.command.jog[1] = 0.1;
  drive_.command.guard_max_age = 10;
  answered(2);
  drive_.run(1);
  drive_.command.jog[1] = 0.4;  // permitted: the robot has hardly begun to accelerate
  drive_.run(1);
  drive_.command.jog[1] = 0.9;
  drive_.run(1);
  EXPECT_TRUE(waits());
  const double stated = rate();
  double reached = 0;
  for (int k = 0; k < 60; ++k) {
    drive_.run(1);
    reached = std::max(reached, rate());
  }
  EXPECT_NEAR(stated, 0.4, 1e-9);
  EXPECT_LE(reached, stated + 1e-9);
}

TEST_P(GuardedJog, WithoutAGuardItBeginsAtOnce) {
  drive_.command.guard_max_age = 0;
  drive_.command.jog[1] = 0.5;
  drive_.run(1);
  EXPECT_TRUE(moving());
  EXPECT_FALSE(waits());
}

/// Largest difference of an axis from the way through the points of a path, as far as `reach` pieces.
double off_path(const PathAhead& path, double reach, const Axes& position) {
  const auto off = [&position](const Axes& from, const Axes& to, double share) {
    double largest = 0;
    for (std::size_t i = 0; i < kAxes; ++i) {
      largest = std::max(largest, std::abs(from[i] + share * (to[i] - from[i]) - position[i]));
    }
    return largest;
  };
  double least = off(path[0], path[0], 0);
  for (int k = 0; k < reach; ++k) {
    const Axes &from = path[static_cast<std::size_t>(k)], &to = path[static_cast<std::size_t>(k + 1)];
    double squared = 0, along = 0;
    for (std::size_t i = 0; i < kAxes; ++i) {
      squared += (to[i] - from[i]) * (to[i] - from[i]);
      along += (to[i] - from[i]) * (position[i] - from[i]);
    }
    const double farthest = std::min(1.0, reach - k);
    least = std::min(least, off(from, to, squared > 0 ? std::clamp(along / squared, 0.0, farthest) : 0));
  }
  return least;
}

/// Bound on how far a motion through the points of a path leaves the straight lines between them, as the
/// guard assumes it.
double bend(const PathAhead& path) {
  double largest = 0;
  for (std::size_t k = 1; k + 1 < path.size(); ++k) {
    for (std::size_t i = 0; i < kAxes; ++i) {
      largest = std::max(largest, std::abs(path[k - 1][i] - 2 * path[k][i] + path[k + 1][i]));
    }
  }
  return largest / 4;
}

/// Random jogs, whose states are answered late, out of order, or never: the robot is on the path that the
/// newest answered state has shown, and not farther on it than at the largest of its present speed and the
/// monitor speeds since then.
TEST(GuardedJogs, RobotStaysOnTheShownPath) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> uniform;
  struct Shown {
    std::int64_t time = 0;
    PathAhead ahead{};
    double rate = 0, monitor_speed = 0;
  };
  int moved = 0, refused = 0;
  for (int run = 0; run < 60; ++run) {
    Drive drive;
    drive.command.operation = Operation::kManual;
    drive.command.guard_max_age = kMaxAge;
    std::deque<std::pair<std::int64_t, Shown>> answers;  // with their arrival
    Shown newest{0, drive.controller.path_ahead(0)};
    std::vector<double> in_force;  // monitor speed of each cycle
    for (int k = 0; k < 300; ++k) {
      if (uniform(random) < 0.05) {
        drive.command.mode = uniform(random) < 0.5 ? Mode::kJointJog : Mode::kCartesianJog;
        drive.command.jog_frame = uniform(random) < 0.5 ? JogFrame::kWorld : JogFrame::kTool;
        drive.command.jog = {};
        const double size = std::pow(10, -3 * uniform(random));
        for (int n = 0; n < 3 && uniform(random) < 0.8; ++n) {
          const auto axis = static_cast<std::size_t>(7 * uniform(random));
          drive.command.jog[axis == 6 ? kTableAxis : axis] = size * (2 * uniform(random) - 1);
        }
      } else if (uniform(random) < 0.1) {
        const double factor = uniform(random) < 0.5 ? 0.5 : 2;
        bool fits = true;
        for (const double value : drive.command.jog) fits = fits && std::abs(factor * value) <= 1;
        for (double& value : drive.command.jog) value *= fits ? factor : 1;
      }
      if (drive.controller.report(drive.now).phase == Phase::kEmergencyStop) break;
      if (k % 2 == 0 && uniform(random) < 0.9) {
        answers.emplace_back(
            drive.now + static_cast<std::int64_t>(80'000 * uniform(random)),
            Shown{drive.now, drive.controller.path_ahead(drive.now), drive.controller.report(drive.now).rate,
                  uniform(random) < 0.1 ? 0 : std::pow(10, -2 * uniform(random))});
      }
      for (auto answer = answers.begin(); answer != answers.end();) {
        const bool arrives = answer->first <= drive.now;
        if (arrives && answer->second.time > newest.time) newest = answer->second;
        answer = arrives ? answers.erase(answer) : answer + 1;
      }
      drive.command.guard_us = newest.time;
      drive.command.monitor_speed = newest.monitor_speed;
      in_force.push_back(newest.monitor_speed);
      const Axes before = drive.position();
      drive.run(1);
      const ControllerError error = drive.controller.report(drive.now).error;
      if (error == ControllerError::kSingular || error == ControllerError::kPathOutOfLimits) break;
      const auto cycles = (drive.now - newest.time) / kCycle;
      const double fastest =
          std::max(newest.rate, *std::max_element(in_force.end() - cycles, in_force.end()));
      moved += drive.position() != before;
      refused += drive.controller.report(drive.now).guard_waits;
      ASSERT_LT(off_path(newest.ahead, fastest * static_cast<double>(cycles), drive.position()),
                1e-6 + kOnTangent * bend(newest.ahead))
          << run << ' ' << k;
    }
  }
  EXPECT_GT(moved, 2000);
  EXPECT_GT(refused, 500);
}

/// Slow jogs outwards, whose path at full speed has no inverse kinematics near the end of the reach: in every
/// cycle the robot is on the path that was shown before it.
TEST(GuardedJogs, ShowTheirPathUpToTheEndOfTheReach) {
  for (const double share : {0.3, 0.03}) {
    Drive drive;
    drive.command.operation = Operation::kManual;
    drive.command.guard_max_age = kMaxAge;
    drive.command.mode = Mode::kCartesianJog;
    drive.command.jog[0] = share;
    ControllerError error = ControllerError::kNone;
    for (int k = 0; k < 10'000 && error == ControllerError::kNone; ++k) {
      drive.command.guard_us = drive.now;
      const PathAhead ahead = drive.controller.path_ahead(drive.now);
      const double fastest = std::max(share, drive.controller.report(drive.now).rate);
      drive.run(1);
      error = drive.controller.report(drive.now).error;
      ASSERT_LT(off_path(ahead, 1.1 * fastest, drive.position()), 5e-4) << share << ' ' << k;
    }
    EXPECT_EQ(error, ControllerError::kSingular);
  }
}

/// A jog that a singular position or a limit has ended stays there while the guard permits no speed and then
/// full speed: the path of what would begin anew has not been answered. After its release it waits for that.
TEST(GuardedJogs, EndedByALimitGoOnOnlyAfterTheirRelease) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-1, 1);
  int ended = 0, went_on = 0;
  for (int run = 0; run < 40; ++run) {
    Drive drive;
    drive.command.operation = Operation::kManual;
    drive.command.guard_max_age = kMaxAge;
    drive.command.mode = Mode::kCartesianJog;
    Axes jog{};
    for (int i = 0; i < 6; ++i) jog[static_cast<std::size_t>(i)] = uniform(random);
    const auto answered = [&drive](int cycles) {
      for (int k = 0; k < cycles; ++k) {
        drive.command.guard_us = drive.now;
        drive.run(1);
      }
    };
    const auto report = [&drive] { return drive.controller.report(drive.now); };
    drive.command.jog = jog;
    for (int k = 0; k < 1000 && report().error == ControllerError::kNone; ++k) answered(1);
    if (report().error == ControllerError::kNone) continue;
    ++ended;
    answered(50);
    const Axes there = drive.position();
    drive.command.monitor_speed = 0;
    answered(10);
    drive.command.monitor_speed = 1;
    answered(20);
    EXPECT_EQ(drive.position(), there) << run;
    drive.command.jog = {};
    answered(2);
    drive.command.jog = jog;
    drive.run(1);
    EXPECT_TRUE(report().guard_waits) << run;
    EXPECT_EQ(drive.position(), there) << run;
    answered(20);
    went_on += drive.position() != there;
  }
  EXPECT_GT(ended, 10);
  EXPECT_GT(went_on, 5);  // those could have begun anew before
}

}  // namespace
