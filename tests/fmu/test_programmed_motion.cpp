// Joint and linear moves: target, path, limits and stops.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "tests/fmu/arm_model.h"

namespace {

using namespace robotcell::control;
using namespace robotcell::testing;

Axes moved(Axes axes, const Axes& change) {
  for (std::size_t i = 0; i < axes.size(); ++i) axes[i] += change[i];
  return axes;
}

const Axes kChange{0.5, 0.3, -0.4, 0.9, -0.2, 1.5, 0.7};

Eigen::Isometry3d target_of_line(const Drive& drive) {
  Eigen::Isometry3d target = drive.arm.tool(drive.position()).pose;
  target.pretranslate(Eigen::Vector3d(0.1, -0.15, 0.05));
  target.linear() = Eigen::AngleAxisd(0.4, Eigen::Vector3d(1, 2, -1).normalized()) * target.linear();
  return target;
}

/// Distance of a pose from the straight path between two others: m off the line, rad off the rotation.
struct OffLine {
  double distance, angle;
};
OffLine off_line(const Eigen::Isometry3d& from, const Eigen::Isometry3d& to, const Eigen::Isometry3d& pose) {
  const Vector6 difference = pose_difference(from, to);
  const Eigen::Vector3d translation = difference.head<3>();
  const double s = translation.dot(pose.translation() - from.translation()) / translation.squaredNorm();
  const Vector6 error = pose_difference(interpolate_pose(from, difference, s), pose);
  return {error.head<3>().norm(), error.tail<3>().norm()};
}

TEST(SmoothProfile, StaysWithinLimitsAndReachesOne) {
  const ProfileLimits limits{2.0, 5.0, 60.0};
  for (const double distance : {1e-4, 0.01, 0.3, 5.0}) {
    const SmoothProfile profile = SmoothProfile::over(distance, limits);
    const double step = profile.duration() / 20000;
    double speed = 0, acceleration = 0, jerk = 0, travel = 0;
    for (double t = 0; t < profile.duration(); t += step) {
      const ProfilePoint a = profile.at(t);
      const ProfilePoint b = profile.at(t + step);
      speed = std::max(speed, std::abs(a.velocity));
      acceleration = std::max(acceleration, std::abs(a.acceleration));
      jerk = std::max(jerk, std::abs(b.acceleration - a.acceleration) / step);
      travel += (a.velocity + b.velocity) / 2 * step;
      EXPECT_NEAR(b.position - a.position, (a.velocity + b.velocity) / 2 * step, 1e-7 * distance);
    }
    EXPECT_NEAR(travel, distance, 1e-7 * distance);
    const double used = std::max({speed / 2.0, acceleration / 5.0, jerk / 60.0});
    EXPECT_LE(used, 1 + 1e-6) << distance;
    EXPECT_GT(used, 0.99) << distance;
  }
}

TEST(JointMove, AllAxesEndExactlyAtTargetSimultaneously) {
  Drive drive;
  const Axes target = moved(home(), kChange);
  drive.start_joints(target);
  drive.run(1);
  EXPECT_EQ(drive.controller.report(drive.now).destination, target);
  EXPECT_FALSE(drive.controller.report(drive.now).at_destination);
  LimitWatch watch(drive);
  drive.run_to_rest([&](const Knots& knots) {
    watch(knots);
    const double share = (knots[0].position - home()[0]) / kChange[0];
    for (std::size_t i = 0; i < kAxes; ++i) {
      EXPECT_NEAR(knots[i].position, home()[i] + share * kChange[i], 1e-13);
    }
  });
  EXPECT_EQ(drive.position(), target);
  EXPECT_TRUE(drive.controller.report(drive.now).at_destination);
  EXPECT_EQ(drive.controller.report(drive.now).progress, 1);
  EXPECT_LE(watch.speed, 1);
  EXPECT_LE(watch.acceleration, 1);
  EXPECT_GT(std::max(watch.speed, watch.acceleration), 0.9);
}

TEST(JointMove, AccelerationIsContinuous) {
  Drive drive;
  drive.start_joints(moved(home(), kChange));
  Knots last = drive.controller.sample(0);
  double before = 0, greatest = 0;
  drive.run_to_rest([&](const Knots& knots) {
    const double acceleration = (knots[5].velocity - last[5].velocity) / 1e-3;
    greatest = std::max(greatest, std::abs(acceleration - before) / 1e-3);
    before = acceleration;
    last = knots;
  });
  // A discontinuity of the acceleration would appear as about 20 / 1e-3.
  EXPECT_LT(greatest, 1.1 * 400);
}

TEST(JointMove, SpeedIsFractionOfFullSpeed) {
  Drive drive;
  drive.command.speed = 0.1;
  Axes target = home();
  target[5] += 3;
  drive.start_joints(target);
  LimitWatch watch(drive);
  drive.run_to_rest(watch);
  EXPECT_NEAR(watch.speed, 0.1, 2e-4);
}

TEST(JointMove, MonitorSpeedScalesMotionOnPath) {
  Drive drive;
  const Axes target = moved(home(), kChange);
  drive.start_joints(target);
  LimitWatch watch(drive);
  const double speeds[] = {1.0, 0.3, 0.0, 0.8, 0.05, 1.0};
  for (const double speed : speeds) {
    drive.command.monitor_speed = speed;
    drive.run(12, [&](const Knots& knots) {
      watch(knots);
      const double share = (knots[0].position - home()[0]) / kChange[0];
      for (std::size_t i = 0; i < kAxes; ++i) {
        EXPECT_NEAR(knots[i].position, home()[i] + share * kChange[i], 1e-13);
      }
    });
  }
  drive.run_to_rest(watch);
  EXPECT_EQ(drive.position(), target);
  EXPECT_LE(watch.acceleration, 1);
}

TEST(JointMove, ToPresentPositionIsDoneImmediately) {
  Drive drive;
  drive.start_joints(home());
  drive.run(2);
  EXPECT_TRUE(drive.controller.report(drive.now).at_destination);
  EXPECT_EQ(drive.position(), home());
}

TEST(JointMove, NewStartFirstStopsRunningMoveOnPath) {
  Drive drive;
  drive.start_joints(moved(home(), kChange));
  LimitWatch watch(drive);
  drive.run(15, watch);
  Axes other = home();
  other[4] += 0.3;
  drive.start_joints(other);
  drive.run_to_rest(watch);
  drive.run_to_rest(watch);
  EXPECT_EQ(drive.position(), other);
  EXPECT_LE(watch.acceleration, 1);
}

/// Runs to rest; the largest deviations of the tool from a line on the way.
OffLine worst_off_line(Drive& drive, const Eigen::Isometry3d& from, const Eigen::Isometry3d& to,
                       LimitWatch& watch) {
  OffLine worst{0, 0};
  drive.run_to_rest([&](const Knots& knots) {
    watch(knots);
    const OffLine off = off_line(from, to, drive.arm.tool(Drive::axes(knots)).pose);
    worst = {std::max(worst.distance, off.distance), std::max(worst.angle, off.angle)};
  });
  return worst;
}

TEST(LineMove, KeepsToolOnStraightLine) {
  for (const double speed : {0.25, 1.0}) {
    Drive drive;
    const Eigen::Isometry3d from = drive.arm.tool(home()).pose;
    const Eigen::Isometry3d to = target_of_line(drive);
    drive.command.speed = speed;
    drive.command.position[kTableAxis] = 0.4;
    drive.start_line(to);
    LimitWatch watch(drive);
    const OffLine worst = worst_off_line(drive, from, to, watch);
    const Vector6 rest = pose_difference(drive.arm.tool(drive.position()).pose, to);
    EXPECT_LT(rest.norm(), 1e-10);
    EXPECT_EQ(drive.position()[kTableAxis], 0.4);
    EXPECT_LE(watch.speed, 1);
    EXPECT_LE(watch.acceleration, 1);
    EXPECT_LT(worst.distance, 1e-6) << "at speed " << speed;
    EXPECT_LT(worst.angle, 2e-6) << "at speed " << speed;
    std::printf("speed %.2f: off the line by %.3g m, %.3g rad; acceleration %.3f of the limit\n", speed,
                worst.distance, worst.angle, watch.acceleration);
  }
}

TEST(LineMove, KeepsToolOnStraightLineWhileAnAxisCarriesTheArm) {
  for (const double travel : {-0.2, 0.25}) {
    Drive drive;
    const Eigen::Isometry3d from = drive.arm.tool(home()).pose;
    Eigen::Isometry3d to = target_of_line(drive);
    to.pretranslate(0.8 * travel * track());
    drive.command.position[kFirstFurtherAxis] = travel;
    drive.start_line(to);
    LimitWatch watch(drive);
    const OffLine worst = worst_off_line(drive, from, to, watch);
    EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kNone);
    EXPECT_LT(pose_difference(drive.arm.tool(drive.position()).pose, to).norm(), 1e-10);
    EXPECT_EQ(drive.position()[kFirstFurtherAxis], travel);
    EXPECT_LE(watch.speed, 1);
    EXPECT_LE(watch.acceleration, 1);
    EXPECT_LT(worst.distance, 1e-6);
    EXPECT_LT(worst.angle, 2e-6);
  }
}

TEST(LineMove, CruisesAtToolSpeedLimit) {
  Drive drive;
  drive.command.speed = 0.1;
  Eigen::Isometry3d to = drive.arm.tool(home()).pose;
  to.pretranslate(Eigen::Vector3d(0, 0.2, 0));
  drive.start_line(to);
  Eigen::Vector3d last = drive.arm.tool(home()).pose.translation();
  std::vector<double> speeds;
  drive.run_to_rest([&](const Knots& knots) {
    const Eigen::Vector3d here = drive.arm.tool(Drive::axes(knots)).pose.translation();
    speeds.push_back((here - last).norm() / 1e-3);
    last = here;
  });
  EXPECT_NEAR(speeds[speeds.size() / 2], 0.1, 1e-6);
  EXPECT_LT(*std::max_element(speeds.begin(), speeds.end()), 0.1 * 1.002);
}

TEST(LineMove, TableThatTravelsAloneKeepsTheCommandedSpeed) {
  Drive drive;
  drive.command.speed = 0.1;
  drive.command.position[kTableAxis] = 1.5;
  drive.start_line(drive.arm.tool(home()).pose);
  LimitWatch watch(drive);
  drive.run_to_rest(watch);
  EXPECT_EQ(drive.position()[kTableAxis], 1.5);
  EXPECT_NEAR(watch.speed, 0.1, 2e-4);
}

TEST(LineMove, StaysOnLineDuringMonitorSpeedChangesAndEmergencyStop) {
  Drive drive;
  const Eigen::Isometry3d from = drive.arm.tool(home()).pose;
  const Eigen::Isometry3d to = target_of_line(drive);
  LimitWatch watch(drive);
  drive.start_line(to);
  const auto check = [&](const Knots& knots) {
    watch(knots);
    const OffLine off = off_line(from, to, drive.arm.tool(Drive::axes(knots)).pose);
    EXPECT_LT(off.distance, 2e-6);
    EXPECT_LT(off.angle, 5e-6);
  };
  drive.run(4, check);
  drive.command.monitor_speed = 0.4;
  drive.run(6, check);
  drive.command.monitor_speed = 1;
  drive.run(8, check);
  drive.command.emergency_stop = true;
  const double seconds = drive.run_to_rest(check);
  EXPECT_LT(seconds, 0.5);
  EXPECT_LT(drive.controller.report(drive.now).progress, 1);
  EXPECT_LE(watch.acceleration, 1);
}

TEST(LineMove, OutOfReachOrThroughSingularityDoesNotStart) {
  Drive drive;
  Eigen::Isometry3d far = drive.arm.tool(home()).pose;
  far.pretranslate(Eigen::Vector3d(1.5, 0, 0));
  drive.start_line(far);
  drive.run(5);
  EXPECT_EQ(drive.position(), home());
  EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kSingular);

  // Halfway the wrist would be singular.
  Axes bent = home(), stretched = home();
  bent[4] = 0.3;
  stretched[4] = 0;
  drive.start_joints(bent);
  drive.run_to_rest();
  const Eigen::Isometry3d from = drive.arm.tool(bent).pose;
  const Vector6 difference = pose_difference(from, drive.arm.tool(stretched).pose);
  drive.start_line(interpolate_pose(from, difference, 2));
  drive.run(5);
  EXPECT_EQ(drive.position(), bent);
  EXPECT_EQ(drive.controller.report(drive.now).error, ControllerError::kSingular);
}

TEST(LineMove, BeyondJointLimitReportsAxis) {
  Drive drive;
  // Joint 6 beyond its limit is a small rotation of the tool.
  Axes near_limit = home();
  near_limit[5] = 6.0;
  drive.start_joints(near_limit);
  drive.run_to_rest();
  Axes beyond = near_limit;
  beyond[5] = 6.5;
  drive.start_line(drive.arm.tool(beyond).pose);
  drive.run(5);
  EXPECT_EQ(drive.position(), near_limit);
  EXPECT_EQ(drive.controller.report(drive.now).limit, 6);
}

/// A segment whose acceleration is largest at its end, and there close to its limit.
std::shared_ptr<const ProgramSegment> hard_stop() {
  constexpr double kPi = 3.14159265358979;
  constexpr int kKnots = 26;
  const double duration = (kKnots - 1) * kCycleSeconds;
  const double travel = 19.8 * 2 * duration * duration / (kPi * kPi);
  std::vector<Axes> points(kKnots, home());
  for (int k = 0; k < kKnots; ++k) points[k][0] -= travel * (1 - std::cos(kPi * k / (kKnots - 1))) / 2;
  return std::make_shared<const ProgramSegment>(interpolated_segment(1, kCycleSeconds, points));
}

TEST(ProgrammedMove, ArrivesWithinAccelerationLimitsAfterAnOverride) {
  const auto segment = hard_stop();
  double largest = 0;
  for (int slow = 0; slow < 20; ++slow) {
    for (const double speed : {1.0, 0.9, 0.5, 0.0}) {
      Drive drive;
      drive.command.mode = Mode::kProgram;
      drive.command.segment = segment;
      ++drive.command.start;
      LimitWatch watch(drive);
      drive.run(2, watch);
      drive.command.monitor_speed = speed;
      drive.run(slow, watch);
      drive.command.monitor_speed = 1;
      drive.run_to_rest(watch);
      EXPECT_EQ(drive.position(), segment->end());
      EXPECT_TRUE(drive.controller.report(drive.now).at_destination);
      EXPECT_EQ(drive.controller.report(drive.now).progress, 1);
      largest = std::max(largest, watch.acceleration);
    }
  }
  EXPECT_LE(largest, 1.001);
}

}  // namespace
