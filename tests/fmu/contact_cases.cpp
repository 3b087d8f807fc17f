// Contact benchmarks with different solvers, for docs/fmu/contact.md: prints one JSON object.
//
// Solvers: "cone" (this project's), "stock" (DART's Dantzig solver with a friction pyramid), "pgs".
#include <cstdio>
#include <dart/constraint/PgsBoxedLcpSolver.hpp>
#include <functional>
#include <nlohmann/json.hpp>

#include "tests/fmu/gripper_world.h"

namespace {

using namespace robotcell;
using namespace robotcell::testing;
using dart::constraint::BoxedLcpSolverPtr;
using nlohmann::json;

constexpr double kFriction = 0.5;
constexpr double kForce = 20;
constexpr double kSlipped = 1e-3;  // m
constexpr int kWatched = 500;      // steps
constexpr int kDirections = 7;     // 0 to 90 degrees
const char* const kSolvers[] = {"cone", "stock", "pgs"};

BoxedLcpSolverPtr solver_named(const std::string& name) {
  if (name == "cone") return std::make_shared<CoulombSolver>();
  if (name == "stock") return std::make_shared<dart::constraint::DantzigBoxedLcpSolver>();
  return std::make_shared<dart::constraint::PgsBoxedLcpSolver>();
}

/// Load relative to Coulomb's limit at which `slips` begins.
double onset(const std::function<bool(double)>& slips) {
  double low = 0, high = 1.6;
  while (high - low > 5e-4) {
    const double share = (low + high) / 2;
    (slips(share) ? high : low) = share;
  }
  return (low + high) / 2;
}

bool slips_on_floor(const std::string& solver, double angle, double share) {
  const auto world = make_world(solver_named(solver));
  add_floor(world, 1.0);
  const SkeletonPtr box = add_free_box(world, "box", {0.06, 0.06, 0.02}, 0.4, kFriction,
                                       Isometry3d(Eigen::Translation3d(0, 0, 0.01)));
  for (int i = 0; i < 50; ++i) world->step();
  const Vector3d before = box->getBodyNode(0)->getWorldTransform().translation();
  const Vector3d pull(std::cos(angle), std::sin(angle), 0);
  world->setGravity(share * kFriction * kGravity * pull - kGravity * Vector3d::UnitZ());
  for (int i = 0; i < kWatched; ++i) world->step();
  return (box->getBodyNode(0)->getWorldTransform().translation() - before).norm() > kSlipped;
}

bool slips_in_grasp(const std::string& solver, double angle, double share) {
  GripperWorld cell(solver_named(solver));
  cell.grip(kForce);
  const Vector3d before = cell.part_in_gripper();
  const double limit = 2 * kPadFriction * kForce / kPartMass;
  cell.run(kWatched, share * limit * Vector3d(0, std::cos(angle), std::sin(angle)));
  return (cell.part_in_gripper() - before).norm() > kSlipped;
}

json onsets(bool (*slips)(const std::string&, double, double)) {
  json table;
  for (const char* solver : kSolvers) {
    for (int i = 0; i < kDirections; ++i) {
      const double angle = i * M_PI / 2 / (kDirections - 1);
      table[solver].push_back(onset([&](double share) { return slips(solver, angle, share); }));
    }
  }
  return table;
}

/// Rotation in the grasp (rad) per step of a bar held 50 mm from its centre of mass.
json turn_of_a_bar(const std::string& solver, std::size_t points) {
  GripperWorld cell(solver_named(solver), a_gripper(), {0.03, 0.03, 0.16}, {0, 0, 0.08});
  cell.set_max_contacts(points);
  cell.grip(40);
  const Isometry3d before = cell.flange_from_part();
  cell.world->setGravity({0, -kGravity, 0});
  json turns;
  for (int i = 0; i < 600; ++i) {
    cell.step();
    turns.push_back(Eigen::AngleAxisd((before.inverse() * cell.flange_from_part()).linear()).angle());
  }
  return turns;
}

/// Slip in the grasp (m) per step at 0.9 of Coulomb's limit, across the fingers.
json slip_below_the_limit(const std::string& solver) {
  GripperWorld cell(solver_named(solver));
  cell.grip(kForce);
  const Vector3d before = cell.part_in_gripper();
  json slips;
  for (int i = 0; i < kWatched; ++i) {
    cell.step({0, 0.9 * 2 * kPadFriction * kForce / kPartMass, 0});
    slips.push_back((cell.part_in_gripper() - before).norm());
  }
  return slips;
}

/// Height (m) per step of the topmost of six boxes, each heavier than the one below.
json height_of_a_stack(const std::string& solver) {
  const auto world = make_world(solver_named(solver));
  add_floor(world, kFriction);
  SkeletonPtr top;
  const double edge = 0.05;
  for (int i = 0; i < 6; ++i) {
    const Isometry3d pose(Eigen::Translation3d(0.002 * (i % 2), 0, (i + 0.5) * edge));
    top = add_free_box(world, "box" + std::to_string(i), {edge, edge, edge}, 0.2 * (i + 1), kFriction, pose);
  }
  json heights;
  for (int i = 0; i < 2000; ++i) {
    world->step();
    heights.push_back(top->getBodyNode(0)->getWorldTransform().translation().z());
  }
  return heights;
}

}  // namespace

int main() {
  json result;
  result["time_step"] = kStep;
  result["floor"] = onsets(slips_on_floor);
  result["grasp"] = onsets(slips_in_grasp);
  for (const char* solver : kSolvers) {
    result["slip"][solver] = slip_below_the_limit(solver);
    result["stack"][solver] = height_of_a_stack(solver);
    for (const std::size_t points : {4u, 1u}) {
      result["bar"][solver][std::to_string(points)] = turn_of_a_bar(solver, points);
    }
  }
  std::printf("%s\n", result.dump().c_str());
  return 0;
}
