// The sequencer without importer: when steps begin and end, what stops them, which values it rejects.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <tuple>

#include "fmu/sequencer/sequencer.h"

namespace robotcell::sequencer {
namespace {

constexpr double kStep = 0.004;   // s, communication step
constexpr double kCycle = 0.016;  // s, controller cycle of the cells

/// A sequencer of one of the test cells: "soft" has a gripper, "dynamic" a presence sensor.
class SequencerCase {
 public:
  explicit SequencerCase(const std::string& cell)
      : sequencer(parse_cell(read_text_file(std::string(SCANCELL_TEST_CELLS) + "/" + cell + "/cell.json"))) {}

  std::uint32_t reference(const std::string& name) const {
    const auto& all = sequencer.table().variables();
    const auto same = [&name](const fmi::Variable& variable) { return variable.name == name; };
    return static_cast<std::uint32_t>(std::find_if(all.begin(), all.end(), same) - all.begin());
  }
  template <class T>
  void set(const std::string& name, T value) {
    sequencer.set<T>(reference(name), value);
  }
  template <class T>
  T get(const std::string& name) {
    return sequencer.get<T>(reference(name));
  }
  void initialize(double start = 0) {
    sequencer.setup(start);
    sequencer.enter_initialization();
    sequencer.exit_initialization();
    time = start;
  }
  void step(int count = 1) {
    for (int i = 0; i < count; ++i, time += kStep) sequencer.do_step(time, kStep);
  }

  Sequencer sequencer;
  double time = 0;
};

/// Message of the exception that a call throws; empty: none.
std::string rejection(const std::function<void()>& call) {
  try {
    call();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "";
}

TEST(Sequencer, WithoutStepsItCommandsNothing) {
  SequencerCase run("dynamic");
  run.initialize();
  run.step(3);
  EXPECT_TRUE(run.get<bool>("finished"));
  EXPECT_EQ(run.get<std::int32_t>("number"), 0);
  EXPECT_EQ(run.get<std::int32_t>("command.mode"), 0);
}

TEST(Sequencer, StepsBeginWithTheFirstCommunicationStepAndLastTheirDurations) {
  for (const double start : {0.0, 100.0, -5.0}) {
    SequencerCase run("dynamic");
    run.set("steps", 2);
    run.set("step[1].duration", 3 * kStep);
    run.set("step[1].q[2]", 0.25);
    run.set("step[2].q[2]", 0.5);
    run.initialize(start);
    EXPECT_EQ(run.get<std::int32_t>("number"), 0);
    for (int i = 0; i < 3; ++i) {
      run.step();
      EXPECT_EQ(run.get<std::int32_t>("number"), 1);
      EXPECT_EQ(run.get<double>("command.q[2]"), 0.25);
    }
    run.step();
    EXPECT_EQ(run.get<std::int32_t>("number"), 2);
    EXPECT_EQ(run.get<double>("command.q[2]"), 0.5);
    EXPECT_FALSE(run.get<bool>("finished"));
    run.step();
    EXPECT_TRUE(run.get<bool>("finished"));
    EXPECT_EQ(run.get<double>("command.q[2]"), 0.5);
  }
}

/// The outputs of the cell show a motion at the earliest a controller cycle and two communication steps after
/// its start: rest at the previous destination does not end the step before.
TEST(Sequencer, MotionEndsNoEarlierThanItsBeginCanBeSeen) {
  SequencerCase run("dynamic");
  run.set("steps", 2);
  run.set("step[1].until", 1);
  run.set("controller.at_destination", true);
  run.initialize();
  const int seen = static_cast<int>((kCycle + 2 * kStep) / kStep + 0.5);
  run.step(seen);
  EXPECT_EQ(run.get<std::int32_t>("number"), 1);
  run.set("controller.at_destination", false);
  run.step(20);
  EXPECT_EQ(run.get<std::int32_t>("number"), 1);
  run.set("controller.at_destination", true);
  run.step();
  EXPECT_EQ(run.get<std::int32_t>("number"), 2);
}

TEST(Sequencer, WaitsForPresenceAndGripper) {
  for (const auto& [cell, until, input] : {std::tuple{"dynamic", 2, "presence[1].detected"},
                                           std::tuple{"soft", 3, "measured.gripper.gripped"}}) {
    SequencerCase run(cell);
    run.set("steps", 2);
    run.set("step[1].until", until);
    run.initialize();
    run.step(50);
    EXPECT_EQ(run.get<std::int32_t>("number"), 1) << cell;
    run.set(input, true);
    run.step();
    EXPECT_EQ(run.get<std::int32_t>("number"), 2) << cell;
  }
}

TEST(Sequencer, RejectedCommandStopsMotionAndKeepsTheGripper) {
  SequencerCase run("soft");
  run.set("steps", 3);
  for (const char* step : {"step[1]", "step[2]"}) {
    run.set(std::string(step) + ".mode", 2);
    run.set(std::string(step) + ".trigger.mode", 1);
    run.set(std::string(step) + ".gripper.mode", 2);
    run.set(std::string(step) + ".gripper.force", 20.0);
  }
  run.initialize();
  run.step(2);
  run.set("controller.error", 5);
  run.step();
  run.set("controller.error", 0);
  run.step(10);
  EXPECT_EQ(run.get<std::int32_t>("error"), 5);
  EXPECT_EQ(run.get<std::int32_t>("number"), 2);
  EXPECT_FALSE(run.get<bool>("finished"));
  EXPECT_EQ(run.get<std::int32_t>("command.mode"), 0);
  EXPECT_EQ(run.get<std::int32_t>("command.trigger.mode"), 0);
  EXPECT_EQ(run.get<std::int32_t>("command.gripper.mode"), 2);
  EXPECT_EQ(run.get<double>("command.gripper.force"), 20.0);
}

TEST(Sequencer, RejectsValuesAndNamesThem) {
  SequencerCase run("dynamic");
  EXPECT_EQ(rejection([&] { run.set("steps", 21); }), "steps must be from 0 to 20 not 21");
  EXPECT_EQ(rejection([&] { run.set("step[2].mode", 7); }), "step[2].mode must be from 0 to 6 not 7");
  EXPECT_EQ(rejection([&] { run.set("step[1].duration", -1.0); }),
            "step[1].duration must be from 0 to 1e+09 s, not -1");
  for (const double value : {std::numeric_limits<double>::infinity(), std::nan("")}) {
    EXPECT_NE(rejection([&] { run.set("step[1].q[1]", value); }), "");
  }
  EXPECT_EQ(rejection([&] { run.set("command.mode", 1); }),
            "command.mode is neither an input nor a parameter");
  EXPECT_EQ(rejection([&] { run.set("steps", 1.0); }), "steps has another type than the called function");
  EXPECT_NE(rejection([&] { run.set("step[1].gripper.mode", 1); }), "");
}

TEST(Sequencer, RejectsConditionsOfAbsentDevices) {
  for (const auto& [cell, until, text] :
       {std::tuple{"soft", 2, "step[2].until is 2, but the cell has no presence sensor"},
        std::tuple{"dynamic", 3, "step[2].until is 3, but the cell has no gripper"}}) {
    SequencerCase run(cell);
    run.set("step[2].until", until);
    run.set("steps", 2);
    EXPECT_EQ(rejection([&run = run] { run.initialize(); }), text);
    SequencerCase unused(cell);
    unused.set("step[2].until", until);
    unused.set("steps", 1);
    EXPECT_EQ(rejection([&] { unused.initialize(); }), "");
  }
}

TEST(Sequencer, RejectsCallsOutOfOrder) {
  SequencerCase run("dynamic");
  EXPECT_NE(rejection([&] { run.step(); }), "");
  run.initialize();
  EXPECT_NE(rejection([&] { run.set("steps", 1); }), "");
  EXPECT_NE(rejection([&] { run.sequencer.do_step(1.0, kStep); }), "");
  EXPECT_NE(rejection([&] { run.sequencer.do_step(0.0, 0.0); }), "");
  EXPECT_NE(rejection([&] { run.sequencer.do_step(0.0, -kStep); }), "");
  run.sequencer.terminate();
  EXPECT_NE(rejection([&] { run.step(); }), "");
}

TEST(Sequencer, ResetRestoresTheStart) {
  SequencerCase run("dynamic");
  run.set("steps", 2);
  run.set("step[1].mode", 2);
  run.initialize();
  run.step(3);
  run.sequencer.reset();
  for (const char* name : {"steps", "step[1].mode", "number", "command.mode"}) {
    EXPECT_EQ(run.get<std::int32_t>(name), 0) << name;
  }
  EXPECT_EQ(run.get<double>("time"), 0);
  run.set("steps", 1);
  run.initialize();
  run.step();
  EXPECT_EQ(run.get<std::int32_t>("number"), 1);
}

}  // namespace
}  // namespace robotcell::sequencer
