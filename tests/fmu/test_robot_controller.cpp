// Operation, jogs, emergency stop, watchdog.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "tests/fmu/arm_model.h"

namespace {

using namespace robotcell::control;
using namespace robotcell::testing;

double tool_speed(const Drive& drive, const Knots& knots) {
  Eigen::Matrix<double, kAxes, 1> rates;
  for (std::size_t i = 0; i < kAxes; ++i) rates[static_cast<int>(i)] = knots[i].velocity;
  return (drive.arm.tool(Drive::axes(knots)).jacobian.topRows<3>() * rates).norm();
}

double greatest_speed(const Knots& knots) {
  double speed = 0;
  for (const Knot& knot : knots) speed = std::max(speed, std::abs(knot.velocity));
  return speed;
}

TEST(Operation, ManualRejectsProgramsAndAutomaticRejectsJogs) {
  Drive drive;
  Axes target = home();
  target[0] += 0.5;
  drive.command.operation = Operation::kManual;
  for (const Mode mode : {Mode::kServo, Mode::kJointMove, Mode::kLineMove, Mode::kProgram}) {
    drive.command.mode = mode;
    drive.command.position = target;
    ++drive.command.start;
    drive.run(20);
    EXPECT_EQ(drive.position(), home());
    EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kManualOperation);
    EXPECT_EQ(drive.controller.report(drive.now).mode, Mode::kHold);
  }
  drive.command.operation = Operation::kAutomatic;
  for (const Mode mode : {Mode::kJointJog, Mode::kCartesianJog}) {
    drive.command.mode = mode;
    drive.command.jog.fill(1);
    drive.run(20);
    EXPECT_EQ(drive.position(), home());
    EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kAutomaticOperation);
  }
}

TEST(Operation, SwitchToManualStopsMoveOnPath) {
  Drive drive;
  Axes target = home();
  for (std::size_t i = 0; i < kAxes; ++i) target[i] += 0.1 * static_cast<double>(i + 1);
  drive.start_joints(target);
  drive.run(12);
  drive.command.operation = Operation::kManual;
  LimitWatch watch(drive);
  drive.run_to_rest([&](const Knots& knots) {
    watch(knots);
    const double share =
        (knots[kTableAxis].position - home()[kTableAxis]) / (target[kTableAxis] - home()[kTableAxis]);
    EXPECT_NEAR(knots[0].position, home()[0] + share * 0.1, 1e-13);
  });
  const Axes stopped = drive.position();
  EXPECT_NE(stopped, target);
  drive.command.operation = Operation::kAutomatic;
  drive.run(20);
  EXPECT_EQ(drive.position(), stopped) << "a stopped move does not go on by itself";
  EXPECT_LE(watch.acceleration, 1);
}

TEST(Operation, StartOfAModeThatWasLeftMovesNothingLater) {
  Drive drive;
  Axes target = home();
  target[0] += 0.5;
  drive.start_joints(target);
  drive.run(12);
  target[1] -= 0.3;
  drive.start_joints(target);  // accepted, but the axes still move
  drive.run(1);
  drive.command.mode = Mode::kLineMove;
  drive.run_to_rest();
  const Axes stopped = drive.position();
  drive.command.mode = Mode::kJointMove;
  drive.run(20);
  EXPECT_EQ(drive.position(), stopped);
}

TEST(Operation, InterruptedMoveDoesNotGoOnWithoutAStart) {
  Drive drive;
  Axes target = home();
  target[0] += 0.5;
  drive.start_joints(target);
  drive.run(12);
  drive.command.mode = Mode::kHold;
  drive.run(2);
  ASSERT_TRUE(drive.controller.report(drive.now).moving);
  drive.command.mode = Mode::kJointMove;
  drive.run_to_rest();
  const Axes stopped = drive.position();
  EXPECT_NE(stopped, target);
  drive.run(20);
  EXPECT_EQ(drive.position(), stopped);
  ++drive.command.start;
  drive.run_to_rest();
  EXPECT_EQ(drive.position(), target);
}

class JogTest : public ::testing::Test {
 protected:
  JogTest() { drive_.command.operation = Operation::kManual; }
  Drive drive_;
};

TEST_F(JogTest, JointJogMovesOneJointAndStopsWhenReleased) {
  drive_.command.mode = Mode::kJointJog;
  drive_.command.jog[5] = -0.5;
  LimitWatch watch(drive_);
  drive_.run(50, watch);
  EXPECT_NEAR(drive_.controller.sample(drive_.now)[5].velocity, -0.5 * 0.1 * 5, 1e-12);
  drive_.command.jog[5] = 0;
  drive_.run_to_rest(watch);
  for (std::size_t i = 0; i < kAxes; ++i) {
    EXPECT_EQ(drive_.position()[i] == home()[i], i != 5);
  }
  EXPECT_LE(watch.acceleration, 1);
  EXPECT_TRUE(drive_.controller.report(drive_.now).at_destination);
}

TEST_F(JogTest, ToolSpeedIsLimitedInManualOperation) {
  for (const Mode mode : {Mode::kJointJog, Mode::kCartesianJog}) {
    Drive drive;
    drive.command.operation = Operation::kManual;
    drive.command.mode = mode;
    drive.command.jog = {1, 1, -1, 0, 0, 0, 0};
    double fastest = 0;
    drive.run(40, [&](const Knots& knots) { fastest = std::max(fastest, tool_speed(drive, knots)); });
    EXPECT_LE(fastest, 0.25 * 1.002);
    EXPECT_GT(fastest, 0.24);
  }
}

/// Largest ratios of the changes of axis speeds and of the tool's twist in a cycle to the jog accelerations.
double jog_change(const Drive& drive, const Knots& before, const Knots& after) {
  const ControllerSettings limits = settings();
  const double cycle = 1e-6 * static_cast<double>(kCycle);
  double ratio = 0;
  for (std::size_t i = 0; i < kAxes; ++i) {
    const double most = limits.jog.joint_share * limits.motion.axes[i].max_acceleration * cycle;
    ratio = std::max(ratio, std::abs(after[i].velocity - before[i].velocity) / most);
  }
  const auto twist = [&](const Knots& knots) {
    Eigen::Matrix<double, kAxes, 1> rates;
    for (std::size_t i = 0; i < kAxes; ++i) rates[static_cast<int>(i)] = knots[i].velocity;
    return Vector6(drive.arm.tool(Drive::axes(before)).jacobian * rates);
  };
  const Vector6 change = twist(after) - twist(before);
  ratio = std::max(ratio, change.head<3>().norm() / (limits.jog.line_acceleration * cycle));
  return std::max(ratio, change.tail<3>().norm() / (limits.jog.angular_acceleration * cycle));
}

TEST_F(JogTest, JogsChangeNoFasterThanTheirAccelerations) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> deflection(-1, 1);
  for (const Mode mode : {Mode::kJointJog, Mode::kCartesianJog}) {
    Drive drive;
    drive.command.operation = Operation::kManual;
    drive.command.mode = mode;
    double largest = 0;
    for (int k = 0; k < 60; ++k) {
      for (double& jog : drive.command.jog) jog = k % 3 == 0 ? deflection(random) : jog * (k % 2);
      drive.command.jog[0] = std::copysign(0.2, deflection(random));  // never released
      for (int cycle = 0; cycle < 6; ++cycle) {
        const Knots before = drive.controller.sample(drive.now);
        drive.run(1);
        largest = std::max(largest, jog_change(drive, before, drive.controller.sample(drive.now)));
      }
    }
    // In Cartesian jogs axes also change their speed because the arm's posture changes.
    EXPECT_LE(largest, mode == Mode::kJointJog ? 1 + 1e-6 : 1.5);
    EXPECT_GT(largest, 0.9);
  }
}

/// A jog that is let go and taken up again while the arm still moves brakes first, then goes on; it is never
/// refused.
TEST_F(JogTest, JogThatBeginsInMotionBrakesFirst) {
  std::mt19937 random(3);
  std::uniform_int_distribution<int> jogged(3, 30), held(1, 8);
  for (const Mode before : {Mode::kJointJog, Mode::kCartesianJog}) {
    for (int k = 0; k < 60; ++k) {
      Drive drive;
      drive.command.operation = Operation::kManual;
      drive.command.mode = before;
      const double sign = k % 2 == 0 ? 0.4 : -0.4;
      drive.command.jog = {};
      drive.command.jog[before == Mode::kJointJog ? 0 : 1] = sign;
      drive.run(jogged(random));
      if (k % 3 != 0) {
        drive.command.mode = Mode::kHold;
        drive.run(held(random));
      }
      drive.command.mode = Mode::kCartesianJog;
      drive.command.jog = {0, 0, -0.4, 0, 0, 0, 0};
      LimitWatch watch(drive);
      drive.run(40, [&](const Knots& knots) {
        watch(knots);
        EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kNone) << k;
      });
      EXPECT_LE(watch.acceleration, 1) << k;
      EXPECT_GT(tool_speed(drive, drive.controller.sample(drive.now)), 0.05) << k;
    }
  }
}

TEST_F(JogTest, ReleasedJointJogBrakesInItsDirection) {
  drive_.command.mode = Mode::kJointJog;
  drive_.command.jog = {0.5, -0.3, 0.2};
  drive_.run(60);
  const Knots start = drive_.controller.sample(drive_.now);
  drive_.command.jog.fill(0);
  drive_.run_to_rest([&](const Knots& knots) {
    const double share = (knots[0].position - start[0].position) / start[0].velocity;
    for (const std::size_t i : {1u, 2u}) {
      EXPECT_NEAR(knots[i].position - start[i].position, share * start[i].velocity, 1e-12);
    }
  });
  EXPECT_LT(std::abs(drive_.position()[0] - start[0].position), std::abs(start[0].velocity) * 0.05);
}

TEST_F(JogTest, JointJogStopsBeforeLimitAndReportsIt) {
  drive_.command.mode = Mode::kJointJog;
  drive_.command.jog[1] = -1;
  drive_.command.jog[2] = 1;
  LimitWatch watch(drive_);
  drive_.run(1500, watch);
  EXPECT_TRUE(watch.inside);
  EXPECT_LE(watch.acceleration, 1);
  EXPECT_NEAR(drive_.position()[1], -3.3, 1e-9);
  EXPECT_NEAR(drive_.position()[2], 4.46, 1e-9);
  EXPECT_EQ(drive_.controller.report(drive_.now).error, ControllerError::kPathOutOfLimits);
  EXPECT_EQ(drive_.controller.report(drive_.now).limit, 2);
  drive_.command.jog[1] = 1;
  drive_.command.jog[2] = 0;
  drive_.run(50, watch);
  EXPECT_GT(drive_.position()[1], -3.2);
  EXPECT_EQ(drive_.controller.report(drive_.now).error, ControllerError::kNone);
}

TEST_F(JogTest, CartesianJogMovesStraightAlongAxisOfFrame) {
  for (const JogFrame frame : {JogFrame::kWorld, JogFrame::kTool}) {
    Drive drive;
    drive.command.operation = Operation::kManual;
    drive.command.mode = Mode::kCartesianJog;
    drive.command.jog_frame = frame;
    drive.command.jog[1] = 0.8;
    const Eigen::Isometry3d start = drive.arm.tool(home()).pose;
    Eigen::Vector3d along_axis = Eigen::Vector3d::UnitY();
    if (frame == JogFrame::kTool) along_axis = start.linear() * along_axis;
    LimitWatch watch(drive);
    const auto check = [&](const Knots& knots) {
      watch(knots);
      const Vector6 difference = pose_difference(start, drive.arm.tool(Drive::axes(knots)).pose);
      const Eigen::Vector3d translation = difference.head<3>();
      EXPECT_LT((translation - along_axis.dot(translation) * along_axis).norm(), 1e-7);
      EXPECT_LT(difference.tail<3>().norm(), 1e-7);
    };
    drive.run(40, check);
    EXPECT_NEAR(tool_speed(drive, drive.controller.sample(drive.now)), 0.2, 1e-6);
    drive.command.jog[1] = 0;
    drive.run_to_rest(check);
    EXPECT_LE(watch.acceleration, 1);
  }
}

TEST_F(JogTest, CartesianJogRotatesAboutToolOrigin) {
  drive_.command.mode = Mode::kCartesianJog;
  drive_.command.jog_frame = JogFrame::kTool;
  drive_.command.jog[3] = 1;
  const Eigen::Isometry3d start = drive_.arm.tool(home()).pose;
  drive_.run(20);
  const Vector6 difference = pose_difference(start, drive_.arm.tool(drive_.position()).pose);
  EXPECT_LT(difference.head<3>().norm(), 1e-9);
  EXPECT_LT(difference.tail<3>().normalized().cross(start.linear().col(0)).norm(), 1e-9);
  EXPECT_GT(difference.tail<3>().norm(), 0.1);
}

TEST_F(JogTest, CartesianJogStopsBeforeSingularityAndReturns) {
  drive_.command.mode = Mode::kCartesianJog;
  for (const std::size_t direction : {0u, 1u, 2u}) {
    for (const double sign : {-1.0, 1.0}) {
      Drive drive;
      drive.command = drive_.command;
      drive.command.jog[direction] = sign;
      LimitWatch watch(drive);
      drive.run(600, watch);
      const Report report = drive.controller.report(drive.now);
      EXPECT_FALSE(report.moving);
      EXPECT_NE(report.error, ControllerError::kNone);
      EXPECT_TRUE(watch.inside);
      EXPECT_LE(watch.speed, 1);
      EXPECT_LE(watch.acceleration, 1) << direction << " " << sign;
      const Axes stuck = drive.position();
      drive.command.jog[direction] = 0;
      drive.run(5);
      drive.command.jog[direction] = -sign;
      drive.run(60, watch);
      EXPECT_NE(drive.position(), stuck);
      EXPECT_TRUE(drive.controller.report(drive.now).moving);
      EXPECT_LE(watch.acceleration, 1);
    }
  }
}

TEST(EmergencyStop, StopsServoMotionOfAllAxesInProportionAtAccelerationLimit) {
  Drive drive;
  drive.command.mode = Mode::kServo;
  Axes rates{0.8, -0.4, 0.4, 1.0, -0.6, 2.0};
  rates[kTableAxis] = 1.5;
  for (int k = 0; k < 40; ++k) {
    for (std::size_t i = 0; i < kAxes; ++i) drive.command.position[i] = home()[i] + rates[i] * k * 0.016;
    drive.run(1);
  }
  drive.command.emergency_stop = true;
  LimitWatch watch(drive);
  const double seconds = drive.run_to_rest([&](const Knots& knots) {
    watch(knots);
    for (std::size_t i = 0; i < kAxes; ++i) {
      EXPECT_NEAR(knots[i].velocity, rates[i] * knots[0].velocity / rates[0], 1e-9);
    }
  });
  EXPECT_LE(watch.acceleration, 1);
  // The table is the slowest to stop: 1.5 rad/s at 6 rad/s^2.
  EXPECT_NEAR(seconds, 1.5 / 6, kCycleSeconds);
  EXPECT_EQ(drive.controller.report(drive.now).phase, Phase::kEmergencyStop);
}

TEST(EmergencyStop, IsLatchedUntilResetInHoldAndMotionIsNotResumed) {
  Drive drive;
  Axes target = home();
  target[0] += 1;
  drive.start_joints(target);
  drive.run(10);
  drive.command.emergency_stop = true;
  drive.run_to_rest();
  const Axes stopped = drive.position();
  drive.command.emergency_stop = false;
  drive.run(10);
  EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kEmergencyStop);
  ++drive.command.reset;  // rejected: a move is still commanded
  drive.run(10);
  ++drive.command.start;
  drive.run(10);
  EXPECT_EQ(drive.position(), stopped);
  drive.command.mode = Mode::kHold;
  ++drive.command.reset;
  drive.run(1);
  EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kNone);
  drive.command.mode = Mode::kJointMove;
  drive.run(10);
  EXPECT_EQ(drive.position(), stopped);
  ++drive.command.start;
  drive.run_to_rest();
  EXPECT_EQ(drive.position(), target);
}

TEST(EmergencyStop, OfACollisionLetsTheAxesReturnButGoNoDeeper) {
  Drive drive;
  drive.command.operation = Operation::kManual;
  const auto jog = [&](double deflection, Collision collision, int cycles) {
    drive.command.mode = deflection == 0 ? Mode::kHold : Mode::kJointJog;
    drive.command.jog[1] = deflection;
    drive.command.collision = collision;
    drive.run(cycles);
    return drive.controller.report(drive.now).phase;
  };
  const auto reset = [&] {
    ++drive.command.reset;
    return jog(0, Collision::kPresent, 5);
  };
  jog(1, Collision::kNone, 20);
  const double free = drive.position()[1];
  EXPECT_EQ(jog(1, Collision::kBegins, 1), Phase::kEmergencyStop);
  jog(1, Collision::kPresent, 30);
  EXPECT_EQ(reset(), Phase::kRest);
  EXPECT_EQ(jog(1, Collision::kPresent, 10), Phase::kMoving);  // on the surface, say
  EXPECT_EQ(jog(1, Collision::kDeepens, 1), Phase::kEmergencyStop);
  jog(1, Collision::kPresent, 30);
  EXPECT_EQ(reset(), Phase::kRest);
  jog(-1, Collision::kPresent, 5);
  while (drive.position()[1] > free + 0.01) {  // out through something else
    ASSERT_EQ(jog(-1, Collision::kDeepens, 1), Phase::kMoving);
  }
  EXPECT_EQ(jog(-1, Collision::kBegins, 1), Phase::kEmergencyStop);
}

TEST(EmergencyStop, StopsJogInItsDirection) {
  Drive drive;
  drive.command.operation = Operation::kManual;
  drive.command.mode = Mode::kCartesianJog;
  drive.command.jog[2] = 1;
  drive.run(40);
  const Eigen::Vector3d from = drive.arm.tool(drive.position()).pose.translation();
  drive.command.emergency_stop = true;
  LimitWatch watch(drive);
  drive.run_to_rest(watch);
  const Eigen::Vector3d difference = drive.arm.tool(drive.position()).pose.translation() - from;
  EXPECT_LT(difference.head<2>().norm(), 0.02 * difference.z());
  EXPECT_LE(watch.acceleration, 1);
}

TEST(MessageAge, ServoWithoutHeartbeatBrakesAndResumes) {
  Drive drive;
  drive.command.mode = Mode::kServo;
  drive.command.max_age = 0.1;
  const auto stream = [&](int cycles, bool alive) {
    for (int k = 0; k < cycles; ++k) {
      drive.command.position[0] += 0.002;
      if (alive) ++drive.command.heartbeat;
      drive.run(1);
    }
  };
  stream(20, true);
  EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kNone);
  stream(6, false);
  EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kNone) << "96 ms are not too old";
  stream(2, false);
  EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kHeartbeatTimeout);
  stream(30, false);
  EXPECT_EQ(greatest_speed(drive.controller.sample(drive.now)), 0);
  stream(40, true);
  EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kNone);
  EXPECT_EQ(drive.position()[0], drive.command.position[0]);
}

TEST(MessageAge, ProgrammedMoveNeedsNoHeartbeat) {
  Drive drive;
  drive.command.max_age = 0.1;
  Axes target = home();
  target[0] += 1;
  drive.start_joints(target);
  EXPECT_GT(drive.run_to_rest(), 0.2);
  EXPECT_EQ(drive.position(), target);
}

}  // namespace
