// Processor time of one dynamics step of the cell's world, and of the bare engine with the same bodies.
//
// usage: robotcell-step-cost CELL.json STEPS: prints {"bare_us": .., "held_us": ..}. The bare world has
// DART's Dantzig solver; the cell's world adds drives, isotropic friction and stick constraints.
#include <ctime>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <dart/constraint/BoxedLcpConstraintSolver.hpp>
#include <dart/constraint/DantzigBoxedLcpSolver.hpp>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/simulation/World.hpp>
#include <future>
#include <thread>

#include "fmu/model/world/capped_collision_detector.h"
#include "fmu/model/world/world.h"
#include "fmu/model/world/world_bodies.h"

namespace {

using namespace robotcell;

/// A thread that waits until the end. Importers are multi-threaded, which makes the engine's many reference
/// counts atomic: 15 % of a step.
class OtherThread {
 public:
  ~OtherThread() {
    end_.set_value();
    thread_.join();
  }

 private:
  std::promise<void> end_;
  std::thread thread_{[until = end_.get_future()] { until.wait(); }};
};

using dart::dynamics::FreeJoint;
using dart::dynamics::SkeletonPtr;

constexpr double kTableRate = 0.5;  // rad/s
constexpr double kBeltSpeed = 0.1;  // m/s
constexpr double kJointRate = 0.1;  // rad/s
constexpr int kRepeats = 5;

double processor_us() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e6 * static_cast<double>(now.tv_sec) + 1e-3 * static_cast<double>(now.tv_nsec);
}

PrescribedMotion motion(const CellDescription& cell, int step) {
  const double t = step * static_cast<double>(cell.time_step_us) * 1e-6;
  PrescribedMotion prescribed;
  for (std::size_t i = 0; i < cell.joints.size(); ++i) {
    prescribed.axes.position[i] = cell.joints[i].start + kJointRate * t;
    prescribed.axes.rate[i] = kJointRate;
  }
  prescribed.axes.position[kTableAxis] = kTableRate * t;
  prescribed.axes.rate[kTableAxis] = kTableRate;
  prescribed.belts.assign(cell.conveyors.size(), {kBeltSpeed * t, kBeltSpeed, kBeltSpeed});
  return prescribed;
}

PrescribedMotion at_rest(const CellDescription& cell) {
  PrescribedMotion prescribed = motion(cell, 0);
  prescribed.axes.rate = {};
  return prescribed;
}

/// Minimum of several runs, microseconds per step.
template <class Step>
double cost(int steps, const Step& step) {
  double best = 1e300;
  int done = 0;
  for (int r = 0; r < kRepeats; ++r) {
    const double start = processor_us();
    for (int i = 0; i < steps / kRepeats; ++i) step(done++);
    best = std::min(best, (processor_us() - start) / (steps / kRepeats));
  }
  return best;
}

/// The engine's world with the bodies of the cell. Only the limit of contacts is ours, which ODE's meshes
/// need.
class BareWorld {
 public:
  explicit BareWorld(const CellDescription& cell) : cell_(cell), kinematics_(cell, AsBuilt{}) {
    world_->setTimeStep(static_cast<double>(cell.time_step_us) * 1e-6);
    world_->setGravity(cell.gravity);
    world_->setConstraintSolver(std::make_unique<dart::constraint::BoxedLcpConstraintSolver>(
        std::make_shared<dart::constraint::DantzigBoxedLcpSolver>()));
    world_->getConstraintSolver()->setCollisionDetector(CappedCollisionDetector::create(4));
    world_->addSkeleton(arm_);
    world_->addSkeleton(table_);
    prescribe(motion(cell, 0));
    for (const ConveyorDescription& conveyor : cell.conveyors) {
      world_->addSkeleton(make_belt(conveyor.name, conveyor));
      world_->getSkeleton(world_->getNumSkeletons() - 1)->setVelocity(0, kBeltSpeed);
    }
    for (const PartDescription& part : cell.parts) add(part);
  }

  void step(int number) {
    prescribe(motion(cell_, number));
    world_->step();
  }

 private:
  void prescribe(const PrescribedMotion& prescribed) {
    const auto joints = static_cast<int>(cell_.joints.size());
    arm_->setPositions(Eigen::Map<const Eigen::VectorXd>(prescribed.axes.position.data(), joints));
    auto* joint = static_cast<FreeJoint*>(table_->getJoint(0));
    const std::size_t platter = kinematics_.numbers().platter();
    joint->setRelativeTransform(kinematics_.frame(platter, prescribed.axes.position, {}).pose);
    joint->setAngularVelocity({0, 0, kTableRate});
  }

  void add(const PartDescription& part) {
    if (!part.free) return;
    SkeletonPtr skeleton = make_free_part(part.name, part, world_->getTimeStep());
    const Eigen::Isometry3d support = kinematics_.frame(part.stands_on, {}, {}).pose;
    skeleton->setPositions(FreeJoint::convertToPositions(support * part.support_from_part));
    world_->addSkeleton(skeleton);
  }

  const CellDescription& cell_;
  Kinematics kinematics_;
  dart::simulation::WorldPtr world_ = dart::simulation::World::create();
  SkeletonPtr arm_ = make_arm(kinematics_, false);
  SkeletonPtr table_ = make_table(cell_.table, true);
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: robotcell-step-cost CELL.json STEPS\n");
    return 2;
  }
  const OtherThread other;
  const CellDescription cell = parse_cell(read_text_file(argv[1]));
  const int steps = std::atoi(argv[2]);
  World world(cell, Kinematics(cell, AsBuilt{}), at_rest(cell));
  const double held =
      cost(steps, [&](int number) { world.step(motion(cell, number), motion(cell, number + 1)); });
  BareWorld bare(cell);
  const double engine = cost(steps, [&](int number) { bare.step(number); });
  std::printf("{\"bare_us\": %.3f, \"held_us\": %.3f}\n", engine, held);
  return 0;
}
