// A six-axis arm similar to the default one, with nominal geometry.
#pragma once

#include <limits>

#include "fmu/control/robot_controller.h"

namespace robotcell::testing {

using control::Axes;

constexpr std::size_t kArmJoints = 6;
constexpr std::int64_t kCycle = 16000;
constexpr double kCycleSeconds = 0.016;

/// Direction in which the first further axis moves the arm.
inline Eigen::Vector3d track() { return {0.6, 0.64, 0.48}; }

/// The flange, where the tool is at the start, is 0.15 m in front of the last joint, off its axis.
class ArmModel : public control::ArmKinematics {
 public:
  control::ToolState tool(const Axes& position, const Eigen::Isometry3d& flange_from_tool =
                                                    Eigen::Isometry3d::Identity()) const override {
    const double rows[kArmJoints][3] = {{0.075, 0.335, -90}, {0.27, 0, 0}, {-0.09, 0, 90},
                                        {0, 0.295, -90},     {0, 0, 90},   {0, 0.08, 0}};
    Eigen::Isometry3d pose(Eigen::Translation3d(position[control::kFirstFurtherAxis] * track()));
    std::array<Eigen::Vector3d, kArmJoints> axes, origins;
    for (std::size_t i = 0; i < kArmJoints; ++i) {
      axes[i] = pose.linear().col(2);
      origins[i] = pose.translation();
      pose = pose * Eigen::AngleAxisd(position[i], Eigen::Vector3d::UnitZ()) *
             Eigen::Translation3d(rows[i][0], 0, rows[i][1]) *
             Eigen::AngleAxisd(rows[i][2] * 3.14159265358979 / 180, Eigen::Vector3d::UnitX());
    }
    control::ToolState tool;
    tool.jacobian.setZero(6, control::kAxes);
    tool.pose = pose * Eigen::Translation3d(0.02, 0.01, 0.15) * flange_from_tool;
    for (std::size_t i = 0; i < kArmJoints; ++i) {
      tool.jacobian.col(static_cast<int>(i)) << axes[i].cross(tool.pose.translation() - origins[i]), axes[i];
    }
    tool.jacobian.col(control::kFirstFurtherAxis).head<3>() = track();
    return tool;
  }
  const std::vector<int>& cartesian_joints() const override { return joints_; }

 private:
  std::vector<int> joints_{0, 1, 2, 3, 4, 5};
};

inline Axes home() { return {0.6, -0.45, 3.4, -1.2, 1.38, -0.17}; }

inline control::ControllerSettings settings() {
  constexpr double kEndless = std::numeric_limits<double>::infinity();
  control::ControllerSettings all;
  all.cycle_us = kCycle;
  const double low[kArmJoints] = {-2.97, -3.3, -0.5, -3.3, -2.1, -6.3};
  const double high[kArmJoints] = {2.97, 0.78, 4.46, 3.3, 2.1, 6.3};
  all.motion.axes.fill({-kEndless, kEndless, 5, 20, 400});
  for (std::size_t i = 0; i < kArmJoints; ++i) all.motion.axes[i] = {low[i], high[i], 5, 20, 400};
  all.motion.axes[control::kTableAxis] = {-kEndless, kEndless, 3, 6, 120};
  all.motion.axes[control::kFirstFurtherAxis] = {-0.5, 0.9, 0.6, 2, 40};
  all.motion.line_speed = 1.0;
  all.motion.line_acceleration = 4.0;
  all.motion.angular_speed = 3.0;
  all.motion.angular_acceleration = 12.0;
  all.jog = {0.1, 0.25, 0.8, 1.0, 3.0};
  return all;
}

/// Runs a controller cycle by cycle; `check` receives every sample, 1 ms apart.
struct Drive {
  ArmModel arm;
  control::RobotController controller{settings(), arm, home()};
  control::Command command;
  std::int64_t now = 0;

  Drive() { command.position = home(); }

  template <class Check>
  void run(int cycles, Check&& check) {
    for (int k = 0; k < cycles; ++k) {
      controller.cycle(now, command);
      for (std::int64_t t = 1000; t <= kCycle; t += 1000) check(controller.sample(now + t));
      now += kCycle;
    }
  }
  void run(int cycles) {
    run(cycles, [](const control::Knots&) {});
  }
  /// Runs until all axes are at rest; returns the duration (s).
  template <class Check>
  double run_to_rest(Check&& check) {
    const std::int64_t start = now;
    do {
      run(1, check);
    } while (controller.report(now).moving && now < start + 60'000'000);
    return static_cast<double>(now - start) * 1e-6;
  }
  double run_to_rest() {
    return run_to_rest([](const control::Knots&) {});
  }

  void start_joints(const Axes& target) {
    command.mode = control::Mode::kJointMove;
    command.position = target;
    ++command.start;
  }
  void start_line(const Eigen::Isometry3d& target) {
    command.mode = control::Mode::kLineMove;
    command.pose = target;
    ++command.start;
  }
  Axes position() const { return axes(controller.sample(now)); }
  static Axes axes(const control::Knots& knots) {
    Axes all;
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = knots[i].position;
    return all;
  }
};

/// Checks speed, acceleration and position limits between samples 1 ms apart.
class LimitWatch {
 public:
  explicit LimitWatch(const Drive& drive) : limits_(settings().motion.axes) {
    last_ = drive.controller.sample(drive.now);
  }
  void operator()(const control::Knots& knots) {
    for (std::size_t i = 0; i < knots.size(); ++i) {
      const double acceleration = std::abs(knots[i].velocity - last_[i].velocity) / 1e-3;
      speed = std::max(speed, std::abs(knots[i].velocity) / limits_[i].max_speed);
      this->acceleration = std::max(this->acceleration, acceleration / limits_[i].max_acceleration);
      inside = inside && knots[i].position >= limits_[i].min && knots[i].position <= limits_[i].max;
    }
    last_ = knots;
  }
  double speed = 0, acceleration = 0;  // fractions of the limits
  bool inside = true;

 private:
  control::Limits limits_;
  control::Knots last_;
};

}  // namespace robotcell::testing
