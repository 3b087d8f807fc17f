// Random sequences of commands against a reference model of the axes that may move.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <random>

#include "tests/fmu/program_model.h"

namespace {

using namespace robotcell::control;
using namespace robotcell::testing;

constexpr int kSequences = 100'000;
constexpr int kCycles = 40;
/// Cycles within which a motion that is no longer commanded comes to rest: 0.25 s of braking, and margin.
constexpr int kStopCycles = 20;
/// rad: a segment starts from this close to its first set-point, also at monitor speed 0.
constexpr double kAtStart = 1e-6;

using AxisSet = std::array<bool, kAxes>;

bool is_move(Mode mode) {
  return mode == Mode::kJointMove || mode == Mode::kLineMove || mode == Mode::kProgram;
}

bool at_rest(const Knots& knots) {
  return std::all_of(knots.begin(), knots.end(), [](const Knot& knot) { return knot.velocity == 0; });
}

double fastest(const Knots& knots) {
  double speed = 0;
  for (const Knot& knot : knots) speed = std::max(speed, std::abs(knot.velocity));
  return speed;
}

bool approaches(const Axes& target, const Knots& knots) {
  double rate = 0;
  for (std::size_t i = 0; i < kAxes; ++i) rate += (target[i] - knots[i].position) * knots[i].velocity;
  return rate > 0;
}

/// Which axes may move, from the history of the commands. It knows nothing of paths, speeds or braking.
class Model {
 public:
  /// Axes that a command may set in motion, or keep in motion, in the cycle from `now` on.
  AxisSet read(std::int64_t now, const Command& command, const Knots& knots, const ArmModel& arm) {
    const Axes position = Drive::axes(knots);
    const bool starts = command.start > start_;
    const bool resets = command.reset > reset_;
    if (command.heartbeat != heartbeat_) heartbeat_us_ = now;
    if (command.collision == Collision::kNone) free_ = position;
    const bool deepens = command.collision == Collision::kDeepens && !approaches(free_, knots);
    if (command.emergency_stop || deepens || command.collision == Collision::kBegins) {
      stopped_ = true;
    } else if (resets && at_rest(knots) && command.mode == Mode::kHold) {
      stopped_ = false;
    }
    start_ = command.start;
    reset_ = command.reset;
    heartbeat_ = command.heartbeat;
    const bool jog = is_jog(command.mode);
    const bool permitted = !stopped_ && jog == (command.operation == Operation::kManual);
    if (!permitted || (move_ && move_->mode != command.mode)) move_.reset();
    if (permitted && starts && is_move(command.mode)) move_ = command;
    if (!permitted) return {};
    const double age = 1e-6 * static_cast<double>(now - heartbeat_us_);
    const bool watched = jog || command.mode == Mode::kServo;
    if (watched && command.max_age > 0 && age > command.max_age) return {};
    if (watched) return streamed_axes(command, position);
    return move_ && command.monitor_speed > 0 ? axes_of_move(position, arm) : AxisSet{};
  }

  bool stopped() const { return stopped_; }
  /// Whether a move slows down by its speed override alone.
  bool paused() const { return move_.has_value(); }

 private:
  static AxisSet streamed_axes(const Command& command, const Axes& position) {
    AxisSet axes{};
    const bool all =
        command.mode == Mode::kCartesianJog &&
        std::any_of(command.jog.begin(), command.jog.begin() + 6, [](double j) { return j != 0; });
    for (std::size_t i = 0; i < kAxes; ++i) {
      axes[i] = command.mode == Mode::kServo ? command.position[i] != position[i]
                                             : command.jog[i] != 0 || (all && i < kArmJoints);
    }
    if (command.mode == Mode::kCartesianJog) axes[6] = axes[7] = false;  // joints that the arm has not
    return axes;
  }

  /// Axes that are not yet where the last accepted start sends them.
  AxisSet axes_of_move(const Axes& position, const ArmModel& arm) const {
    const Limits limits = settings().motion.axes;
    const Command& move = *move_;
    AxisSet axes{};
    Axes target = position;
    if (move.mode == Mode::kJointMove) target = move.position;
    if (move.mode == Mode::kLineMove) target[kTableAxis] = move.position[kTableAxis];
    if (move.mode == Mode::kProgram && move.segment) target = move.segment->end();
    for (std::size_t i = 0; i < kAxes; ++i) {
      if (target[i] < limits[i].min || target[i] > limits[i].max) return {};
      axes[i] = target[i] != position[i];
    }
    if (move.mode == Mode::kLineMove && !move.pose) return {};
    const bool tool_moves =
        move.mode == Mode::kLineMove && pose_difference(arm.tool(position).pose, *move.pose).norm() > 1e-9;
    for (std::size_t i = 0; i < kArmJoints && tool_moves; ++i) axes[i] = true;
    return axes;
  }

  std::int32_t start_ = 0, reset_ = 0, heartbeat_ = 0;
  std::int64_t heartbeat_us_ = 0;
  Axes free_{};  // position without a collision
  bool stopped_ = false;
  std::optional<Command> move_;  // the last accepted start, until another mode or a stop takes its place
};

/// Draws commands: in each cycle a few inputs change, in any order.
class Draw {
 public:
  explicit Draw(unsigned seed) : random_(seed) {}

  void change(Command& command) {
    if (command.collision == Collision::kBegins) command.collision = Collision::kPresent;
    while (chance(0.3)) change_one(command);
    if (chance(0.1)) let_move(command);
  }

 private:
  /// What an operator does to let the robot move.
  void let_move(Command& command) {
    if (command.emergency_stop || command.collision != Collision::kNone || chance(0.3)) {
      command.emergency_stop = false;
      command.collision = Collision::kNone;
      command.mode = Mode::kHold;
      ++command.reset;
      return;
    }
    command.mode = static_cast<Mode>(index(7));
    command.operation = is_jog(command.mode) ? Operation::kManual : Operation::kAutomatic;
    command.monitor_speed = 1;
    command.max_age = 0;
    ++command.start;
  }

  bool chance(double probability) { return number(0, 1) < probability; }
  double number(double low, double high) {
    return low + (high - low) * static_cast<double>(random_()) / 4294967296.0;
  }
  int index(int count) { return static_cast<int>(number(0, count)); }

  void change_one(Command& command) {
    const auto axis = static_cast<std::size_t>(index(8) == 7 ? kTableAxis : index(6));
    switch (index(13)) {
      case 0:
      case 1:
        command.mode = static_cast<Mode>(index(7));
        return;
      case 2:
      case 3:
        command.start += chance(0.9) ? 1 : -1;
        return;
      case 4:
        command.reset += chance(0.9) ? 1 : -1;
        if (chance(0.5)) command.mode = Mode::kHold;
        return;
      case 5:
        command.emergency_stop = chance(0.1);
        return;
      case 6:
        command.collision = chance(0.9) ? Collision::kNone : static_cast<Collision>(index(4));
        return;
      case 7:
        command.operation = static_cast<Operation>(index(2));
        return;
      case 8:
        command.monitor_speed = chance(0.2) ? 0 : number(0, 1);
        return;
      case 9:
        command.position[axis] = chance(0.1) ? number(-9, 9) : home()[axis] + number(-0.2, 0.2);
        return;
      case 10:
        command.jog[axis] = chance(0.3) ? 0 : number(-1, 1);
        command.jog_frame = static_cast<JogFrame>(index(2));
        return;
      case 11:
        ++command.heartbeat;
        command.max_age = chance(0.5) ? 0 : number(0, 0.1);
        return;
      default:
        command.speed = number(1e-6, 1);
        command.segment = chance(0.2) ? nullptr : segments()[static_cast<std::size_t>(index(2))];
        command.pose.reset();
        if (chance(0.8)) command.pose = near_home();
        return;
    }
  }

  Eigen::Isometry3d near_home() {
    static const Eigen::Isometry3d pose = ArmModel().tool(home()).pose;
    return Eigen::Translation3d(number(-0.01, 0.01), number(-0.01, 0.01), chance(0.1) ? 2 : 0) * pose;
  }

  static const std::array<std::shared_ptr<const ProgramSegment>, 2>& segments() {
    static const std::array<std::shared_ptr<const ProgramSegment>, 2> all{straight(0, 0.02, 0.6),
                                                                          straight(kTableAxis, 0.3, 0.6)};
    return all;
  }

  std::mt19937 random_;
};

struct Counts {
  int moving = 0, resting = 0, jogs = 0, moves = 0;
};

/// Whether a jog or a move from rest must set an axis in motion: far from all limits, with nothing against
/// it.
bool must_move(const Command& command, std::size_t axis, const AxisSet& may, const Axes& position) {
  if (!may[axis] || command.collision != Collision::kNone || axis >= kArmJoints ||
      std::abs(position[axis] - home()[axis]) > 0.3) {
    return false;
  }
  if (command.mode == Mode::kJointJog) return std::abs(command.jog[axis]) > 0.1;
  return command.mode == Mode::kJointMove && command.monitor_speed > 0.1 && command.speed > 0.1 &&
         std::abs(command.position[axis] - position[axis]) > 0.01;
}

void run_sequence(unsigned seed, Counts& counts) {
  Drive drive;
  Model model;
  Draw draw(seed);
  int unwanted = 0;  // cycles for which nothing may move
  for (int cycle = 0; cycle < kCycles; ++cycle) {
    draw.change(drive.command);
    const Knots before = drive.controller.sample(drive.now);
    const Axes from = Drive::axes(before);
    const bool rests = at_rest(before);
    const AxisSet may = model.read(drive.now, drive.command, before, drive.arm);
    LimitWatch watch(drive);
    drive.run(1, watch);
    const Axes to = drive.position();
    const bool any = std::any_of(may.begin(), may.end(), [](bool axis) { return axis; });
    unwanted = any ? 0 : unwanted + 1;
    ASSERT_LE(watch.acceleration, 1.001) << "cycle " << cycle;
    ASSERT_TRUE(watch.inside) << "cycle " << cycle;
    ASSERT_TRUE(unwanted <= kStopCycles || to == from) << "cycle " << cycle;
    // Set-points begin with the velocity of the motion before. On a straight line of the tool a joint may
    // become a little faster while the tool brakes.
    const double speed_limit = 1.02 * fastest(before) + 1e-4;
    const bool brakes = unwanted > 1 && !model.paused() && drive.command.mode != Mode::kServo;
    ASSERT_TRUE(!brakes || fastest(drive.controller.sample(drive.now)) <= speed_limit) << "cycle " << cycle;
    ASSERT_EQ(drive.controller.report(drive.now).phase == Phase::kEmergencyStop, model.stopped())
        << "cycle " << cycle;
    if (!rests) {
      ++counts.moving;
      continue;
    }
    ++counts.resting;
    const bool moves = to != from;
    for (std::size_t i = 0; i < kAxes; ++i) {
      ASSERT_TRUE(may[i] || std::abs(to[i] - from[i]) <= kAtStart)
          << "axis " << i + 1 << " in cycle " << cycle;
      if (!must_move(drive.command, i, may, from)) continue;
      ++(drive.command.mode == Mode::kJointJog ? counts.jogs : counts.moves);
      ASSERT_TRUE(moves) << "axis " << i + 1 << " in cycle " << cycle;
    }
  }
}

TEST(MotionModel, NothingMovesWithoutAnAcceptedCommandInRandomSequences) {
  Counts counts;
  for (unsigned seed = 0; seed < kSequences; ++seed) {
    run_sequence(seed, counts);
    ASSERT_FALSE(HasFatalFailure()) << "sequence " << seed;
  }
  std::printf("cycles: %d moving, %d at rest; %d jogs, %d moves from rest\n", counts.moving, counts.resting,
              counts.jogs, counts.moves);
  EXPECT_GT(counts.moving, 4 * kSequences);
  EXPECT_GT(counts.resting, 5 * kSequences);
  EXPECT_GT(counts.jogs, kSequences / 8);
  EXPECT_GT(counts.moves, kSequences / 8);
}

}  // namespace
