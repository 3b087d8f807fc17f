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
using robotcell::control::ServoCommand;
using robotcell::control::ServoController;

constexpr std::int64_t kCycle = 16000;
constexpr double kSeconds = 1e-6;

std::array<AxisLimits, kAxes> limits() {
  std::array<AxisLimits, kAxes> all;
  all.fill({-1.0, 2.0, 3.0, 20.0});
  all[6].min = -std::numeric_limits<double>::infinity();
  all[6].max = std::numeric_limits<double>::infinity();
  return all;
}

/// Feeds random commands and passes every sample, 250 microseconds apart, to a check.
template <class Check>
void drive_at_random(ServoController& servo, double spread, const Check& check) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> target(-spread, spread);
  std::bernoulli_distribution follows(0.9);
  for (std::int64_t cycle = 0; cycle < 500; ++cycle) {
    ServoCommand command{follows(random), {}};
    for (double& position : command.position) position = target(random);
    servo.cycle(cycle * kCycle, command);
    for (std::int64_t t = 250; t <= kCycle; t += 250) check(servo.sample(cycle * kCycle + t));
  }
}

TEST(ServoController, NeverExceedsSpeedOrPosition) {
  ServoController servo(limits(), kCycle, {});
  double fastest = 0;
  drive_at_random(servo, 4.0, [&fastest](const Knots& knots) {
    for (int i = 0; i < kAxes; ++i) {
      const auto& knot = knots[static_cast<std::size_t>(i)];
      ASSERT_LE(std::abs(knot.velocity), 3.0 * (1 + 1e-9));
      const bool inside = knot.position >= -1.0 && knot.position <= 2.0;
      ASSERT_TRUE(i == 6 || inside) << knot.position;
      fastest = std::max(fastest, std::abs(knot.velocity));
    }
  });
  EXPECT_GT(fastest, 2.99);
}

TEST(ServoController, VelocityIsContinuousDerivativeOfPosition) {
  ServoController servo(limits(), kCycle, {});
  Knots before{};
  // Within one cycle a velocity parabola between +-3 changes by at most 16 * 3 / T per second; inside the
  // position limits there is no hard stop.
  drive_at_random(servo, 0.8, [&before](const Knots& knots) {
    for (std::size_t i = 0; i < kAxes; ++i) {
      const double change = knots[i].velocity - before[i].velocity;
      ASSERT_LE(std::abs(change), 16 * 3.0 / (kCycle * kSeconds) * 250 * kSeconds);
      const double mean = (knots[i].velocity + before[i].velocity) / 2;
      ASSERT_NEAR(knots[i].position - before[i].position, mean * 250 * kSeconds, 1e-5);
    }
    before = knots;
  });
}

TEST(ServoController, ReachesNearSetPointInOneCycle) {
  ServoController servo(limits(), kCycle, {});
  ServoCommand command{true, {}};
  command.position.fill(0.01);
  servo.cycle(0, command);
  for (const auto& knot : servo.sample(kCycle)) EXPECT_EQ(knot.position, 0.01);
  EXPECT_EQ(servo.state().limit, 0);
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

TEST(ServoController, RestoredStateRepeatsMotion) {
  ServoController servo(limits(), kCycle, {});
  ServoCommand command{true, {}};
  command.position.fill(0.02);
  servo.cycle(0, command);
  ServoController other(limits(), kCycle, {});
  other.restore(servo.state());
  for (ServoController* each : {&servo, &other}) each->cycle(kCycle, command);
  for (std::size_t i = 0; i < kAxes; ++i) {
    EXPECT_EQ(servo.sample(kCycle + 5000)[i].position, other.sample(kCycle + 5000)[i].position);
  }
}

}  // namespace
