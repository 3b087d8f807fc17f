// Properties of servo motion between cycles for random set-points.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "fmu/control/servo_controller.h"

namespace {

using robotcell::control::AxisLimits;
using robotcell::control::kAxes;
using robotcell::control::Knots;
using robotcell::control::kTableAxis;
using robotcell::control::ServoCommand;
using robotcell::control::ServoController;

constexpr std::int64_t kCycle = 16000;
constexpr double kSeconds = 1e-6;

std::array<AxisLimits, kAxes> limits() {
  std::array<AxisLimits, kAxes> all;
  all.fill({-1.0, 2.0, 3.0, 20.0, 400.0});
  all[kTableAxis].min = -std::numeric_limits<double>::infinity();
  all[kTableAxis].max = std::numeric_limits<double>::infinity();
  return all;
}

constexpr double kMaxSpeed = 3.0;          // rad/s
constexpr double kMaxAcceleration = 20.0;  // rad/s^2
constexpr std::int64_t kSample = 250;      // microseconds

/// Feeds random commands, each for 1 to 40 cycles, and passes every sample to a check.
template <class Check>
void drive_at_random(ServoController& servo, double spread, const Check& check) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> target(-spread, spread);
  std::uniform_int_distribution<int> length(1, 40);
  std::bernoulli_distribution follows(0.9);
  for (std::int64_t cycle = 0; cycle < 3000;) {
    ServoCommand command{follows(random), {}};
    for (double& position : command.position) position = target(random);
    for (int left = length(random); left > 0; --left, ++cycle) {
      servo.cycle(cycle * kCycle, command);
      for (std::int64_t t = kSample; t <= kCycle; t += kSample) check(servo.sample(cycle * kCycle + t));
    }
  }
}

TEST(ServoController, NeverExceedsSpeedOrPosition) {
  ServoController servo(limits(), kCycle, {});
  double fastest = 0;
  drive_at_random(servo, 4.0, [&fastest](const Knots& knots) {
    for (std::size_t i = 0; i < kAxes; ++i) {
      const auto& knot = knots[i];
      ASSERT_LE(std::abs(knot.velocity), kMaxSpeed * (1 + 1e-9));
      const bool inside = knot.position >= -1.0 && knot.position <= 2.0;
      ASSERT_TRUE(i == kTableAxis || inside) << knot.position;
      fastest = std::max(fastest, std::abs(knot.velocity));
    }
  });
  EXPECT_GT(fastest, 0.997 * kMaxSpeed);
}

/// Also where set-points are beyond the position limits: an axis brakes before them.
TEST(ServoController, NeverExceedsAcceleration) {
  for (const double spread : {0.003, 0.1, 4.0}) {
    ServoController servo(limits(), kCycle, {});
    Knots before{};
    double largest = 0;
    drive_at_random(servo, spread, [&](const Knots& knots) {
      for (std::size_t i = 0; i < kAxes; ++i) {
        const double change = std::abs(knots[i].velocity - before[i].velocity);
        ASSERT_LE(change, kMaxAcceleration * (1 + 1e-6) * kSample * kSeconds);
        largest = std::max(largest, change);
      }
      before = knots;
    });
    EXPECT_GT(largest, 0.99 * kMaxAcceleration * kSample * kSeconds);
  }
}

TEST(ServoController, VelocityIsDerivativeOfPosition) {
  ServoController servo(limits(), kCycle, {});
  Knots before{};
  drive_at_random(servo, 4.0, [&before](const Knots& knots) {
    for (std::size_t i = 0; i < kAxes; ++i) {
      const double mean = (knots[i].velocity + before[i].velocity) / 2;
      ASSERT_NEAR(knots[i].position - before[i].position, mean * kSample * kSeconds, 1e-7);
    }
    before = knots;
  });
}

TEST(ServoController, ReachesNearSetPointInOneCycle) {
  ServoController servo(limits(), kCycle, {});
  ServoCommand command{true, {}};
  command.position.fill(0.001);
  servo.cycle(0, command);
  for (const auto& knot : servo.sample(kCycle)) EXPECT_EQ(knot.position, 0.001);
  EXPECT_EQ(servo.state().limit, 0);
}

/// A jump of the set-point is followed like a time-optimal move from rest to rest, without overshoot.
TEST(ServoController, JumpIsReachedInShortestTime) {
  const double ramps = kMaxSpeed * kMaxSpeed / kMaxAcceleration;  // distance of both ramps of a longer move
  for (const double jump : {0.01, 0.05, 0.3, 1.0, -0.9}) {
    ServoController servo(limits(), kCycle, {});
    ServoCommand command{true, {}};
    command.position.fill(jump);
    const double distance = std::abs(jump);
    const double shortest =
        distance > ramps ? (distance + ramps) / kMaxSpeed : 2 * std::sqrt(distance / kMaxAcceleration);
    const auto cycles = static_cast<std::int64_t>(std::ceil(shortest / (kCycle * kSeconds))) + 1;
    for (std::int64_t cycle = 0; cycle < cycles; ++cycle) {
      servo.cycle(cycle * kCycle, command);
      for (std::int64_t t = kSample; t <= kCycle; t += kSample) {
        EXPECT_LE(std::abs(servo.sample(cycle * kCycle + t)[0].position), distance * (1 + 1e-12));
      }
    }
    servo.cycle(cycles * kCycle, command);
    EXPECT_NEAR(servo.sample(cycles * kCycle)[0].position, jump, 1e-12);
    EXPECT_FALSE(servo.moving((cycles + 1) * kCycle));
  }
}

/// A stream that begins with a jump of the velocity is followed exactly after it has been caught up.
TEST(ServoController, CatchesUpWithMovingSetPoint) {
  ServoController servo(limits(), kCycle, {});
  const auto stream = [](std::int64_t cycle) { return 0.15 * std::sin(8 * kCycle * kSeconds * (cycle + 1)); };
  for (std::int64_t cycle = 0; cycle < 60; ++cycle) {
    ServoCommand command{true, {}};
    command.position.fill(stream(cycle));
    servo.cycle(cycle * kCycle, command);
    const double reached = servo.sample((cycle + 1) * kCycle)[2].position;
    EXPECT_EQ(servo.state().limit == 0, reached == stream(cycle));
    EXPECT_TRUE(cycle < 20 || reached == stream(cycle)) << cycle;
    EXPECT_TRUE(cycle != 1 || std::abs(reached - stream(cycle)) > 1e-3);
  }
}

TEST(ServoController, ReportsFirstLimitedAxis) {
  ServoController servo(limits(), kCycle, {});
  ServoCommand command{true, {}};
  command.position[3] = 1.0;  // 62 rad/s away
  command.position[5] = 5.0;
  servo.cycle(0, command);
  EXPECT_EQ(servo.state().limit, 4);
  EXPECT_TRUE(servo.moving(0));
}

}  // namespace
