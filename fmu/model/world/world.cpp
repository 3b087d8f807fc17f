#include "fmu/model/world/world.h"

#include <algorithm>
#include <cmath>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/simulation/World.hpp>
#include <limits>
#include <locale>
#include <mutex>
#include <sstream>

#include "fmu/control/time_units.h"
#include "fmu/model/world/engine_locks.h"
#include "fmu/model/world/engine_setup.h"
#include "fmu/model/world/soft_body.h"
#include "fmu/model/world/soft_collision_detector.h"
#include "fmu/model/world/world_bodies.h"
#include "fmu/model/world/world_engine.h"

namespace robotcell {
namespace {

using namespace dart::dynamics;
using Eigen::Isometry3d;
using Eigen::Vector3d;

constexpr double kSettlingTime = 1;         // s
constexpr double kMaxSettlingTilt = 0.02;   // rad, and
constexpr double kMaxSettlingShift = 1e-3;  // m: maximum motion while a standing part settles

bool any_free(const CellDescription& cell) {
  return std::any_of(cell.parts.begin(), cell.parts.end(), [](const PartDescription& p) { return p.free; });
}

/// Whether any body that others can touch moves by forces.
bool contacts_occur(const CellDescription& cell) { return any_free(cell) || cell.dynamics; }

/// Static compression of a soft part that stands on three of its points.
double static_compression(const PartDescription& part, double gravity) {
  return part.soft ? part.inertial.mass * gravity / (3 * part.soft->stiffness) : 0;
}

/// Rejects a soft part that sinks by more than its height: its points would be far inside the support, all of
/// them in contact.
void check_compression(const PartDescription& part, const Vector3d& gravity_in_part) {
  const double gravity = gravity_in_part.norm();
  const double compression = static_compression(part, gravity);
  if (compression == 0) return;
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const Vector3d& vertex : part.hull.vertices) {
    const double height = vertex.dot(gravity_in_part) / gravity;
    low = std::min(low, height);
    high = std::max(high, height);
  }
  if (compression <= high - low) return;
  std::ostringstream text;
  text.imbue(std::locale::classic());
  text << "part '" << part.name << "': soft.stiffness = " << part.soft->stiffness
       << " N/m: the part sinks by " << compression << " m on three of its points, more than its height of "
       << high - low << " m; expected at least " << part.soft->stiffness * compression / (high - low)
       << " N/m";
  throw DescriptionError(text.str());
}

}  // namespace

World::World(const CellDescription& cell, const Kinematics& kinematics, const PrescribedMotion& start)
    : time_step_(static_cast<double>(cell.time_step_us) * kSecondsPerMicrosecond), kinematics_(kinematics) {
  try {
    {
      const std::lock_guard<std::mutex> lock(building_mutex());
      build(cell, start);
    }
    // The simulated second of settling creates nothing in the engine, so that other instances need not wait.
    WorldState initial = state();
    if (any_free(cell)) settle(cell, start);
    initial.parts = free_parts();
    restore(start, initial);
  } catch (...) {
    const std::lock_guard<std::mutex> lock(building_mutex());
    engine_.reset();
    throw;
  }
}

void World::build(const CellDescription& cell, const PrescribedMotion& start) {
  prepare_engine();
  engine_ = std::make_unique<Engine>();
  engine_->stick = cell.contact.stick;
  engine_->world = dart::simulation::World::create();
  engine_->world->setGravity(cell.gravity);
  engine_->world->setTimeStep(time_step_);
  const bool soft =
      std::any_of(cell.parts.begin(), cell.parts.end(), [](const auto& part) { return part.soft; });
  const auto soft_detector = soft ? SoftCollisionDetector::create(cell.contact.points) : nullptr;
  engine_->detector = soft ? soft_detector : CappedCollisionDetector::create(cell.contact.points);
  engine_->world->setConstraintSolver(make_solver(cell.contact, engine_->solver_fallbacks));
  engine_->world->getConstraintSolver()->setCollisionDetector(engine_->detector);
  add_supports(cell);
  add_dynamics(cell);
  if (cell.gripper) add_gripper(*cell.gripper);
  prescribe(start);
  // The weights of gripper and links hang on the motors, from a base that an axis may tilt.
  if (engine_->dynamic_arm) engine_->dynamic_arm->settle(start.axes.position);
  if (contacts_occur(cell)) add_contact_bodies(cell);
  add_parts(cell);
  if (soft) engine_->connect_soft_parts(*soft_detector);
  engine_->exclude_contacts();
  for (const ContactPair& pair : cell.contact.pairs) engine_->apply(pair);
  intersecting_bodies_ = engine_->exclude_intersecting_bodies();
}

World::~World() {
  const std::lock_guard<std::mutex> lock(building_mutex());
  engine_.reset();
}

/// Adds the driven bodies; they get contact shapes only where something can touch them.
void World::add_supports(const CellDescription& cell) {
  const bool collides = contacts_occur(cell);
  Engine& engine = *engine_;
  engine.arm = make_arm(kinematics_, cell.gripper.has_value());
  engine.table = make_table(cell.table, collides);
  engine.ground = make_ground();
  for (const SkeletonPtr& skeleton : {engine.arm, engine.table, engine.ground}) {
    engine.world->addSkeleton(skeleton);
  }
  BodyNode* platter = engine.table->getBodyNode(0);
  const Tree& tree = kinematics_.tree();
  const FrameNumbers& numbers = kinematics_.numbers();
  engine.first_link = engine.arm->getNumBodyNodes() - numbers.joints;
  engine.base_carrier = tree[numbers.base()].parent;
  const auto root = [](const SkeletonPtr& skeleton) {
    return static_cast<FreeJoint*>(skeleton->getJoint(0));
  };
  engine.prescribed = {{root(engine.table), numbers.platter()}};
  if (engine.first_link > 0) engine.prescribed.emplace_back(root(engine.arm), numbers.base());
  engine.frames.assign(tree.size(), {engine.ground->getBodyNode(0)});
  if (engine.first_link > 0) engine.frames[numbers.base()].body = engine.arm->getBodyNode(0);
  for (std::size_t i = 0; i < numbers.joints; ++i) {
    engine.frames[numbers.joint(i)].body = engine.link(i);
  }
  engine.frames[numbers.platter()].body = platter;
  for (std::size_t i = 0; i < numbers.axes; ++i) {
    const SkeletonPtr carriage = make_carriage("carriage " + std::to_string(i + 1));
    engine.world->addSkeleton(carriage);
    engine.prescribed.emplace_back(root(carriage), numbers.axis(i));
    engine.frames[numbers.axis(i)].body = carriage->getBodyNode(0);
  }
  for (std::size_t i = 1; i < tree.size(); ++i) {
    const bool has_body = i == numbers.base() && engine.first_link > 0;
    if (tree[i].kind != robotcell::Joint::Kind::kFixed || has_body) continue;
    const Carrier& parent = engine.frames[tree[i].parent];
    engine.frames[i] = {parent.body,
                        parent.body_from_frame * tree[i].parent_from_joint * tree[i].joint_from_frame};
  }
  engine.add_support({"table", collides ? platter->getShapeNode(0) : nullptr, platter, cell.table.friction,
                      true, numbers.platter()});
  for (const ConveyorDescription& conveyor : cell.conveyors) {
    engine.belts.push_back(make_belt("belt " + std::to_string(engine.belts.size() + 1), conveyor));
    engine.world->addSkeleton(engine.belts.back());
    BodyNode* belt = engine.belts.back()->getBodyNode(0);
    engine.add_support({conveyor.name, belt->getShapeNode(0), belt, conveyor.friction, true});
  }
}

void World::add_gripper(const GripperDescription& description) {
  Engine& engine = *engine_;
  const std::size_t flange = kinematics_.numbers().flange();
  engine.gripper = std::make_unique<Gripper>(description, engine.frames[flange].body, time_step_);
  engine.gripper->connect(engine.world);
  for (std::size_t i = 0; i < 2; ++i) {
    engine.add_support(
        {"gripper", engine.gripper->pad(i), engine.gripper->finger(i), description.friction, false, flange});
  }
}

/// Adds contact shapes to links, sensor, gripper, table and surroundings.
void World::add_contact_bodies(const CellDescription& cell) {
  Engine& engine = *engine_;
  for (const ContactBody& contact_body : cell.contact.bodies) {
    const auto& [body, body_from_frame] = engine.frames[contact_body.frame];
    const bool prescribed = body->getSkeleton() != engine.arm || !engine.dynamic_arm;
    ShapeNode* shape =
        add_contact_shape(body, body_from_frame, contact_body.hull, cell.contact.friction, prescribed);
    engine.add_support({contact_body.name, shape, body, cell.contact.friction, false, contact_body.frame});
  }
}

void World::add_dynamics(const CellDescription& cell) {
  if (!cell.dynamics) return;
  std::vector<std::array<double, 2>> limits;
  for (const JointDescription& joint : cell.joints) limits.push_back({joint.limits.min, joint.limits.max});
  engine_->dynamic_arm = std::make_unique<DynamicArm>(engine_->arm, *cell.dynamics, limits);
}

void World::add_parts(const CellDescription& cell) {
  Engine& engine = *engine_;
  for (const PartDescription& part : cell.parts) {
    const Carrier& carrier = engine.frames[part.stands_on];
    Part added;
    added.free = part.free;
    added.soft = part.soft.has_value();
    added.clamped = {part.stands_on, part.support_from_part};
    if (part.free) {
      added.skeleton = make_free_part("part " + std::to_string(engine.parts.size() + 1), part, time_step_);
      added.friction = part.friction;
      added.radius_of_gyration = std::sqrt(part.inertial.inertia.trace() / 2 / part.inertial.mass);
      engine.world->addSkeleton(added.skeleton);
      added.skeleton->setPositions(FreeJoint::convertToPositions(carrier.pose() * part.support_from_part));
    }
    BodyNode* body = part.free ? added.body() : carrier.body;
    ShapeNode* shape = part.free ? body->getShapeNode(0) : nullptr;
    if (!part.free && contacts_occur(cell) && !part.hull.faces.empty()) {
      shape = add_hull(body, carrier.body_from_frame * part.support_from_part, part);
    }
    engine.parts.push_back(added);
    engine.add_support({part.name, shape, body, part.friction, false, part.stands_on});
  }
}

/// Lets free parts settle before time starts, and rejects unstable parts.
void World::settle(const CellDescription& cell, const PrescribedMotion& start) {
  PrescribedMotion still = start;
  still.axes.rate = {};
  std::vector<Isometry3d> before;
  for (const Part& part : engine_->parts) before.push_back(part.free ? part.pose() : Isometry3d::Identity());
  for (std::size_t i = 0; i < before.size(); ++i) {
    check_compression(cell.parts[i], before[i].linear().transpose() * cell.gravity);
  }
  const auto steps = static_cast<int>(std::ceil(kSettlingTime / time_step_));
  for (int i = 0; i < steps; ++i) step(still, still);
  for (std::size_t i = 0; i < engine_->parts.size(); ++i) {
    if (!engine_->parts[i].free) continue;
    const Isometry3d change = before[i].inverse() * engine_->parts[i].pose();
    const double tilt = Eigen::AngleAxisd(change.linear()).angle();
    const double shift = change.translation().norm();
    if (tilt < kMaxSettlingTilt &&
        shift < kMaxSettlingShift + static_compression(cell.parts[i], cell.gravity.norm()))
      continue;
    const std::string name = "parts[" + std::to_string(i) + "]";
    throw DescriptionError(name + ": the free part '" + cell.parts[i].name + "' is not stable at " + name +
                           ".support_from_part: while settling it rotates by " + std::to_string(tilt) +
                           " rad and moves by " + std::to_string(shift) + " m");
  }
}

void World::prescribe(const PrescribedMotion& prescribed) {
  const AxesState& axes = prescribed.axes;
  for (std::size_t i = 0; i < kinematics_.joints() && !engine_->dynamic_arm; ++i) {
    engine_->joint(i)->setPosition(0, axes.position[i]);
  }
  for (const auto& [joint, frame] : engine_->prescribed) {
    joint->setRelativeTransform(kinematics_.frame(frame, axes.position, {}).pose);
  }
  for (std::size_t i = 0; i < prescribed.belts.size(); ++i) {
    engine_->supports[1 + i].travel.x() = prescribed.belts[i].travel;
  }
}

/// Prescribes the mean velocities of a step, which starts at the present prescribed poses.
void World::prescribe_velocities(const PrescribedMotion& from, const PrescribedMotion& to) {
  std::array<double, kAxes> speed;
  for (std::size_t i = 0; i < kAxes; ++i) {
    speed[i] = (to.axes.position[i] - from.axes.position[i]) / time_step_;
  }
  const auto twist = [this](std::size_t frame, const std::array<double, kAxes>& position,
                            const std::array<double, kAxes>& rate) {
    const Motion motion = kinematics_.frame(frame, position, rate);
    Eigen::Vector6d twist;
    twist << motion.pose.linear().transpose() * motion.angular_velocity,
        motion.pose.linear().transpose() * motion.velocity;
    return twist;
  };
  for (const auto& [joint, frame] : engine_->prescribed) {
    const Eigen::Vector6d mean = twist(frame, from.axes.position, speed);
    if (joint->getActuatorType() != dart::dynamics::Joint::VELOCITY) {
      joint->setRelativeSpatialVelocity(mean);
      continue;
    }
    // The engine accelerates the base of an arm on an axis to the mean velocity, which joints and fingers
    // feel.
    const Eigen::Vector6d change =
        twist(frame, to.axes.position, to.axes.rate) - twist(frame, from.axes.position, from.axes.rate);
    joint->setVelocities(mean - change);
    joint->setCommands(mean);
  }
  if (engine_->dynamic_arm) {
    std::array<MotorCommand, kMaxJoints> motors;
    for (std::size_t i = 0; i < kinematics_.joints(); ++i) motors[i] = {to.axes.position[i], to.axes.rate[i]};
    engine_->dynamic_arm->before_step(motors, time_step_);
  } else if (engine_->gripper) {
    for (std::size_t i = 0; i < kinematics_.joints(); ++i) engine_->joint(i)->setCommand(0, speed[i]);
  } else {
    for (std::size_t i = 0; i < kinematics_.joints(); ++i) engine_->joint(i)->setVelocity(0, speed[i]);
  }
  for (std::size_t i = 0; i < engine_->belts.size(); ++i) {
    engine_->belts[i]->setVelocity(0, (to.belts[i].travel - from.belts[i].travel) / time_step_);
  }
}

void World::step(const PrescribedMotion& from, const PrescribedMotion& to) {
  if (!engine_->has_free_motion()) return prescribe(to);
  prepare_thread();
  prescribe(from);
  prescribe_velocities(from, to);
  if (engine_->gripper) engine_->gripper->begin_step();
  engine_->begin_step();
  engine_->world->step();
  if (engine_->dynamic_arm) engine_->dynamic_arm->after_step();
  prescribe(to);
  if (engine_->gripper) engine_->gripper->end_step();
  engine_->end_step(time_step_);
}

PartPlacement World::placement(std::size_t index) const {
  const Part& part = engine_->parts[index];
  if (!part.free) return part.clamped;
  const std::size_t frame = engine_->frame_of(part.main_support);
  return {frame, engine_->frames[frame].pose().inverse() * part.pose()};
}

std::int32_t World::solver_fallbacks() const {
  const std::int32_t friction = engine_->dynamic_arm ? engine_->dynamic_arm->unconverged() : 0;
  return *engine_->solver_fallbacks + friction;
}

std::int32_t World::truncated_contacts() const { return engine_->detector->truncated(); }

ArmDynamicsState World::arm() const {
  return engine_->dynamic_arm ? engine_->dynamic_arm->state() : ArmDynamicsState();
}

Isometry3d World::link_pose(std::size_t link) const { return engine_->link(link)->getWorldTransform(); }

void World::command_gripper(const GripperCommand& command) {
  if (engine_->gripper) engine_->gripper->command(command);
}

GripperPoint World::gripper() const {
  GripperPoint point;
  const Gripper* gripper = engine_->gripper.get();
  if (gripper == nullptr) return point;
  for (std::size_t i = 0; i < 2; ++i) {
    point.opening[i] = gripper->opening(i);
    const auto [normal, whole] = engine_->pad_force(i);
    point.outputs.normal_force[i] = normal;
    Eigen::Map<Vector3d>(point.outputs.contact_force[i].data()) = whole;
  }
  point.outputs.force = gripper->force();
  point.outputs.gripped = gripper->is_gripping();
  return point;
}

GraspState World::grasp() const {
  GraspState state;
  if (!engine_->gripper) return state;
  state.gripper = engine_->gripper->state();
  for (std::size_t i = 0; i < kinematics_.joints(); ++i)
    state.arm_speed[i] = engine_->joint(i)->getVelocity(0);
  return state;
}

std::vector<FreePartState> World::free_parts() const {
  std::vector<FreePartState> states;
  for (const Part& part : engine_->parts) {
    FreePartState& state = states.emplace_back();
    if (!part.free) continue;
    Eigen::Map<Eigen::Matrix<double, 6, 1>>(state.position.data()) = part.skeleton->getPositions();
    Eigen::Map<Eigen::Matrix<double, 6, 1>>(state.velocity.data()) = part.skeleton->getVelocities();
    state.main_support = part.main_support;
    state.stick_constraint = part.stick.constraint;
    state.points = soft_points(part.body());
  }
  return states;
}

WorldState World::state() const { return {arm(), free_parts(), grasp()}; }

void World::restore(const PrescribedMotion& prescribed, const WorldState& world) {
  engine_->check(world.parts);
  if (engine_->dynamic_arm) engine_->dynamic_arm->restore(world.arm);
  prescribe(prescribed);
  if (engine_->gripper) {
    const GraspState& grasp = world.grasp;
    engine_->gripper->restore(grasp.gripper);
    for (std::size_t i = 0; i < kinematics_.joints(); ++i)
      engine_->joint(i)->setVelocity(0, grasp.arm_speed[i]);
  }
  for (std::size_t i = 0; i < world.parts.size(); ++i) {
    Part& part = engine_->parts[i];
    if (!part.free) continue;
    const FreePartState& state = world.parts[i];
    part.skeleton->setPositions(Eigen::Map<const Eigen::Matrix<double, 6, 1>>(state.position.data()));
    part.skeleton->setVelocities(Eigen::Map<const Eigen::Matrix<double, 6, 1>>(state.velocity.data()));
    part.main_support = state.main_support;
    part.stick.constraint = state.stick_constraint;
    restore_soft_points(part.body(), state.points);
  }
}

}  // namespace robotcell
