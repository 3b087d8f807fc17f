// The dynamics world against the kinematics.
#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

#include "fmu/model/description/cell_description.h"
#include "fmu/model/world/world.h"

namespace {

using namespace robotcell;

CellDescription a_cell() {
  CellDescription cell;
  cell.time_step_us = 1000;
  cell.controller_cycle_us = 16000;
  cell.gravity = {0, 0, -9.80665};
  cell.world_from_base =
      Eigen::Translation3d(0.1, 0.2, 0.3) * Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitY());
  const double rows[][3] = {{0.075, 0.335, -1.5708}, {0.27, 0, 0},   {-0.09, 0, 1.5708},
                            {0, 0.295, -1.5708},     {0, 0, 1.5708}, {0, 0.08, 0}};
  for (const auto& row : rows) {
    JointDescription& joint = cell.joints.emplace_back();
    joint.a = row[0];
    joint.d = row[1];
    joint.alpha = row[2];
  }
  cell.carrier_from_sensor = Eigen::Isometry3d::Identity();
  cell.table.world_from_table = Eigen::Translation3d(0.45, 0, 0.1) * Eigen::Quaterniond::Identity();
  cell.parts.emplace_back();
  cell.parts[0].support_from_part = Eigen::Translation3d(0.02, 0, 0) * Eigen::Quaterniond::Identity();
  return cell;
}

PrescribedMotion somewhere(double t) {
  PrescribedMotion prescribed;
  AxesState& axes = prescribed.axes;
  for (std::size_t i = 0; i < kAxes; ++i) axes.position[i] = 0.3 * std::sin(t * static_cast<double>(i + 1));
  return prescribed;
}

TEST(World, LinkPosesMatchKinematics) {
  AsBuilt as_built;
  as_built.dh[1] = {0.001, -0.002, 0.003, 0.004, 0.005};
  as_built.dh[4] = {-0.001, 0.002, -0.003, 0.004, 0};
  const CellDescription cell = a_cell();
  const Kinematics kinematics(cell, as_built);
  World world(cell, kinematics, somewhere(0));
  for (int k = 0; k < 50; ++k) {
    const PrescribedMotion to = somewhere(0.01 * (k + 1));
    world.step(somewhere(0.01 * k), to);
    for (std::size_t i = 0; i < kinematics.joints(); ++i) {
      const auto expected =
          kinematics.frame(kinematics.numbers().joint(i), to.axes.position, to.axes.rate).pose;
      EXPECT_TRUE(world.link_pose(i).isApprox(expected, 1e-12)) << "link " << i + 1;
    }
  }
}

// Worlds share the engine's process-wide state, also those that are destroyed because a part is unstable.
TEST(World, UnstablePartsAreRefusedInParallelThreads) {
  const CellDescription stable = parse_cell(read_text_file(SCANCELL_TEST_CELLS "/free/cell.json"));
  CellDescription unstable = stable;
  unstable.parts[0].support_from_part.rotate(Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitX()));
  std::atomic<int> built{0}, refused{0};
  const auto build = [&](const CellDescription& cell) {
    try {
      const World world(cell, Kinematics(cell, AsBuilt{}), {});
      ++built;
    } catch (const DescriptionError&) {
      ++refused;
    }
  };
  std::vector<std::thread> threads;
  for (int thread = 0; thread < 4; ++thread) {
    threads.emplace_back([&] {
      for (int round = 0; round < 5; ++round) {
        build(unstable);
        build(stable);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(built, 20);
  EXPECT_EQ(refused, 20);
}

TEST(World, FallingPartIsStoppedAtMaximumDistance) {
  const CellDescription cell = parse_cell(read_text_file(SCANCELL_TEST_CELLS "/free/cell.json"));
  PrescribedMotion still;
  for (std::size_t i = 0; i < cell.joints.size(); ++i) still.axes.position[i] = cell.joints[i].start;
  World world(cell, Kinematics(cell, AsBuilt{}), still);
  const auto parts = world.state().parts;
  const auto put = [&](double height, double speed) {
    WorldState moved = world.state();
    moved.parts = parts;
    moved.parts[0].position[5] = height;
    moved.parts[0].velocity[5] = speed;
    moved.parts[0].stick_constraint = {};
    world.restore(still, moved);
  };
  const auto height_after = [&](int steps) {
    for (int i = 0; i < steps; ++i) world.step(still, still);
    return world.placement(0).frame_from_part.translation().z();
  };
  put(-9999, -440);
  const double rest = height_after(10);
  EXPECT_NEAR(rest, -10000, 1);
  EXPECT_EQ(height_after(100), rest);
  EXPECT_EQ(world.state().parts[0].velocity[5], 0);
  // A state from before the fall restores the part.
  put(2, 0);
  EXPECT_NEAR(height_after(100), 2 - 0.5 * 9.80665 * 0.1 * 0.1, 0.01);
}

/// A box that balances on an edge, 1 mrad off: it falls within a second of simulated time.
TEST(World, SlowlyTippingPartIsRejectedAtAnyTimeStep) {
  for (const std::int64_t step_us : {100, 1000}) {
    CellDescription cell = parse_cell(read_text_file(SCANCELL_TEST_CELLS "/free/cell.json"));
    cell.time_step_us = step_us;
    const double tilt = std::atan2(0.03, 0.025) + 1e-3;  // the centre of mass is above the edge at x = 0.03
    cell.parts[0].support_from_part = Eigen::Translation3d(0, 0, 0.03 * std::sin(tilt)) *
                                      Eigen::AngleAxisd(tilt, Eigen::Vector3d::UnitY()) *
                                      Eigen::Quaterniond::Identity();
    PrescribedMotion still;
    for (std::size_t i = 0; i < cell.joints.size(); ++i) still.axes.position[i] = cell.joints[i].start;
    EXPECT_THROW(World(cell, Kinematics(cell, AsBuilt{}), still), DescriptionError) << step_us;
  }
}

}  // namespace
