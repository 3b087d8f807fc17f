// Dynamic drives of a single joint against closed forms: friction, saturation and position limits.
#include <gtest/gtest.h>

#include <cmath>
#include <dart/dynamics/RevoluteJoint.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <dart/simulation/World.hpp>

#include "fmu/model/world/dynamic_arm.h"

namespace {

using namespace robotcell;

constexpr std::size_t kJoints = 6;
constexpr double kGravity = 9.81;
constexpr double kArmMass = 4;
constexpr double kLever = 0.3;  // m, of the centre of mass
constexpr double kOwnInertia = 0.05;
constexpr double kInertia = kOwnInertia + kArmMass * kLever * kLever;
constexpr double kNoSupport = 1e-9;

/// Six joints about the world's z axis; all mass is in the first link, gravity points along -y.
class OneJoint {
 public:
  explicit OneJoint(const DriveDescription& drive, double step = 1e-3, double gravity = kGravity)
      : step_(step), world_(dart::simulation::World::create()) {
    ArmDynamicsDescription description;
    description.drives.assign(kJoints, {0.01, 1e3, 1e6, 0, 0, 0, 0});
    description.links.resize(kJoints);
    description.drives[0] = drive;
    for (RigidInertia& link : description.links)
      link = {kNoSupport, {0, 0, 0}, Eigen::Vector3d::Constant(kNoSupport).asDiagonal()};
    description.links[0] = {kArmMass, {kLever, 0, 0}, Eigen::Vector3d::Constant(kOwnInertia).asDiagonal()};
    auto skeleton = dart::dynamics::Skeleton::create("arm");
    dart::dynamics::BodyNode* parent = nullptr;
    for (std::size_t i = 0; i < kJoints; ++i) {
      dart::dynamics::RevoluteJoint::Properties joint;
      joint.mName = "joint" + std::to_string(i);
      joint.mAxis = Eigen::Vector3d::UnitZ();
      const dart::dynamics::BodyNode::AspectProperties body("link" + std::to_string(i));
      parent = skeleton
                   ->createJointAndBodyNodePair<dart::dynamics::RevoluteJoint>(
                       parent, joint, dart::dynamics::BodyNode::Properties(body))
                   .second;
    }
    world_->setTimeStep(step);
    world_->addSkeleton(skeleton);
    const std::vector<std::array<double, 2>> limits(kJoints, {-1, 1});
    arm_ = std::make_unique<DynamicArm>(skeleton, description, limits);
    set_gravity(gravity);
    arm_->settle({});
  }

  void set_gravity(double gravity) { world_->setGravity({0, -gravity, 0}); }

  void step(const MotorCommand& command = {}) {
    std::array<MotorCommand, kMaxJoints> all{};
    all[0] = command;
    arm_->before_step(all, step_);
    world_->step();
    arm_->after_step();
  }
  void run(double seconds) {
    for (double t = 0; t < seconds; t += step_) step();
  }

  double link() const { return arm_->state().position[0]; }
  double rate() const { return arm_->state().rate[0]; }
  const MotorState& motor() const { return arm_->state().motors[0]; }
  ArmDynamicsState state() const { return arm_->state(); }
  void restore(const ArmDynamicsState& state) { arm_->restore(state); }

 private:
  double step_;
  dart::simulation::WorldPtr world_;
  std::unique_ptr<DynamicArm> arm_;
};

/// motor inertia, torque, stiffness, damping, backlash, Coulomb, viscous
DriveDescription stiff() { return {0.4, 500, 2e4, 20, 0, 0, 0}; }

TEST(DynamicArm, CoulombFrictionStopsCoastingJoint) {
  DriveDescription drive = stiff();
  drive.max_torque = 0;  // unpowered: the motor coasts with the link
  drive.coulomb_friction = 3;
  OneJoint joint(drive, 1e-3, 0);
  ArmDynamicsState coasting = joint.state();
  coasting.rate[0] = coasting.motors[0].rate = 1.0;
  coasting.motors[0].catching_up = true;
  joint.restore(coasting);
  const double deceleration = 3 / (kInertia + 0.4);
  for (double t = 1e-3; t < 1 / deceleration - 0.02; t += 1e-3) {
    joint.step();
    // Link and motor oscillate against each other; only friction reduces their momentum.
    const double together = (kInertia * joint.rate() + 0.4 * joint.motor().rate) / (kInertia + 0.4);
    ASSERT_NEAR(together, 1 - deceleration * t, 3e-3);
  }
  joint.run(0.5);
  EXPECT_NEAR(joint.link(), 1 / (2 * deceleration), 2e-3);
  const double stopped = joint.link();
  joint.run(0.1);
  EXPECT_NEAR(joint.link(), stopped, 1e-9);
}

TEST(DynamicArm, ViscousFrictionSlowsCoastingJointExponentially) {
  DriveDescription drive = stiff();
  drive.max_torque = 0;
  drive.viscous_friction = 5;
  OneJoint joint(drive, 1e-3, 0);
  ArmDynamicsState coasting = joint.state();
  coasting.rate[0] = coasting.motors[0].rate = 1.0;
  coasting.motors[0].catching_up = true;
  joint.restore(coasting);
  joint.run(0.1);
  EXPECT_NEAR(joint.motor().rate, std::exp(-5 / (kInertia + 0.4) * 0.1), 0.02);
}

TEST(DynamicArm, CoulombFrictionHoldsSmallLoad) {
  DriveDescription drive = stiff();
  drive.coulomb_friction = 20;
  OneJoint joint(drive, 1e-3, 0);
  joint.set_gravity(kGravity);  // 11.8 N m, below the friction
  joint.run(0.5);
  EXPECT_NEAR(joint.link(), 0, 1e-9);
}

TEST(DynamicArm, MotorTorqueSaturates) {
  DriveDescription drive = stiff();
  drive.max_torque = 30;
  OneJoint joint(drive, 1e-3, 0);
  const double commanded = 100;  // rad/s^2: needs about 84 N m
  double time = 0;
  for (int i = 1; i <= 60; ++i) {
    time = 1e-3 * i;
    joint.step({commanded * time * time / 2, commanded * time});
    ASSERT_LE(std::abs(joint.motor().torque), 30);
  }
  // The full torque accelerates motor and link.
  const double acceleration = 30 / (kInertia + 0.4);
  EXPECT_NEAR(joint.motor().position, acceleration * time * time / 2, 0.05 * acceleration * time * time / 2);
  EXPECT_TRUE(joint.motor().catching_up);
  const MotorCommand end{0.2, 0};
  for (int i = 0; i < 3000; ++i) joint.step(end);
  EXPECT_FALSE(joint.motor().catching_up);
  EXPECT_EQ(joint.motor().position, 0.2);
}

TEST(DynamicArm, StaysWithinPositionLimits) {
  DriveDescription drive = stiff();
  drive.gear_stiffness = 200;
  OneJoint joint(drive, 1e-3, 0);
  double highest = 0;
  for (int i = 1; i <= 1000; ++i) {
    const double t = std::min(1e-3 * i, 0.2);
    joint.step({5 * t, t < 0.2 ? 5.0 : 0.0});
    highest = std::max(highest, joint.link());
  }
  EXPECT_EQ(highest, 1);
}

}  // namespace
