#include "fmu/model/world.h"

#include <ode/odeinit.h>

#include <algorithm>
#include <dart/collision/CollisionObject.hpp>
#include <dart/constraint/BoxedLcpConstraintSolver.hpp>
#include <dart/constraint/DantzigBoxedLcpSolver.hpp>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/CylinderShape.hpp>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/dynamics/RevoluteJoint.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <dart/dynamics/WeldJoint.hpp>
#include <dart/simulation/World.hpp>
#include <mutex>

#include "fmu/model/capped_collision_detector.h"
#include "fmu/model/hull_shape.h"

namespace robotcell {
namespace {

using namespace dart::dynamics;
using Eigen::Isometry3d;
using Eigen::Vector3d;

constexpr double kSecondsPerTick = 1e-6;
constexpr std::size_t kMostFaces = 60;
constexpr int kSettlingSteps = 1000;
constexpr double kMostTilt = 0.02;     // rad, and
constexpr double kMostSinking = 1e-3;  // m, by which a part that stands may settle

/// The engine keeps process-wide registers of frames, and ODE a counter of its users: one instance at a time
/// may be built or torn down.
std::mutex& building() {
  static std::mutex mutex;
  return mutex;
}

/// ODE stays initialised as long as the library is loaded, however many worlds come and go.
struct OdeLibrary {
  OdeLibrary() { dInitODE2(0); }
  ~OdeLibrary() { dCloseODE(); }
};

/// ODE keeps collision caches per thread; an importer may step an instance from any thread.
void prepare_thread() {
  thread_local const int prepared = dAllocateODEDataForThread(dAllocateMaskAll);
  static_cast<void>(prepared);
}

SkeletonPtr make_arm(const Kinematics& kinematics) {
  SkeletonPtr arm = Skeleton::create("arm");
  BodyNode* parent = nullptr;
  for (int i = 0; i < kJoints; ++i) {
    RevoluteJoint::Properties joint;
    joint.mName = "joint" + std::to_string(i + 1);
    joint.mAxis = Vector3d::UnitZ();
    if (i == 0) joint.mT_ParentBodyToJoint = kinematics.world_from_base();
    joint.mT_ChildBodyToJoint = kinematics.joint_from_link(i).inverse();
    BodyNode::Properties body(BodyNode::AspectProperties("link" + std::to_string(i + 1)));
    parent = arm->createJointAndBodyNodePair<RevoluteJoint>(parent, joint, body).second;
  }
  arm->setMobile(false);
  return arm;
}

SkeletonPtr make_table(const CellDescription& cell, const Kinematics& kinematics) {
  SkeletonPtr table = Skeleton::create("table");
  RevoluteJoint::Properties joint;
  joint.mName = "axis";
  joint.mAxis = Vector3d::UnitZ();
  joint.mT_ParentBodyToJoint = kinematics.world_from_axis();
  joint.mT_ChildBodyToJoint = kinematics.axis_from_platter().inverse();
  BodyNode* platter = table
                          ->createJointAndBodyNodePair<RevoluteJoint>(
                              nullptr, joint, BodyNode::Properties(BodyNode::AspectProperties("platter")))
                          .second;
  if (cell.part.free) {
    auto shape = std::make_shared<CylinderShape>(cell.table.radius, cell.table.thickness);
    ShapeNode* node = platter->createShapeNodeWith<CollisionAspect, DynamicsAspect>(shape);
    node->setRelativeTranslation({0, 0, -cell.table.thickness / 2});
    node->getDynamicsAspect()->setFrictionCoeff(cell.table.friction);
  }
  table->setMobile(false);
  return table;
}

/// The part's own hull while the collision detector can cope with it, or a reduced one.
Hull contact_hull(const PartDescription& part) {
  if (part.hull_faces.size() <= kMostFaces) return {part.hull_vertices, part.hull_faces};
  return support_hull(part.hull_vertices, part.table_from_part.linear().row(2).transpose());
}

SkeletonPtr make_free_part(const PartDescription& part) {
  SkeletonPtr skeleton = Skeleton::create("part");
  BodyNode* body = skeleton->createJointAndBodyNodePair<FreeJoint>().second;
  body->setInertia(Inertia(part.mass, part.centre_of_mass, part.inertia));
  ShapeNode* node =
      body->createShapeNodeWith<CollisionAspect, DynamicsAspect>(make_hull_shape(contact_hull(part)));
  node->getDynamicsAspect()->setFrictionCoeff(part.friction);
  node->getDynamicsAspect()->setFirstFrictionDirectionFrame(Frame::World());
  return skeleton;
}

}  // namespace

struct World::Bodies {
  dart::simulation::WorldPtr world;
  SkeletonPtr arm;
  SkeletonPtr table;
  SkeletonPtr part;  // null for a clamped part

  BodyNode* platter() const { return table->getBodyNode(0); }
  BodyNode* part_body() const { return part->getBodyNode(0); }
};

World::World(const CellDescription& cell, const Kinematics& kinematics, const AxesState& start)
    : time_step_(static_cast<double>(cell.time_step_us) * kSecondsPerTick),
      free_(cell.part.free),
      clamped_pose_(cell.part.table_from_part),
      anchor_(std::min(cell.table.friction, cell.part.friction)) {
  const std::lock_guard<std::mutex> lock(building());
  static const OdeLibrary ode_library;
  prepare_thread();
  bodies_ = std::make_unique<Bodies>();
  bodies_->world = dart::simulation::World::create();
  bodies_->world->setGravity(cell.gravity);
  bodies_->world->setTimeStep(time_step_);
  auto* solver = bodies_->world->getConstraintSolver();
  solver->setCollisionDetector(CappedCollisionDetector::create());
  bodies_->arm = make_arm(kinematics);
  bodies_->table = make_table(cell, kinematics);
  bodies_->world->addSkeleton(bodies_->arm);
  bodies_->world->addSkeleton(bodies_->table);
  set_axes(start);
  if (!free_) return;
  bodies_->part = make_free_part(cell.part);
  bodies_->part->setPositions(
      FreeJoint::convertToPositions(bodies_->platter()->getWorldTransform() * cell.part.table_from_part));
  bodies_->world->addSkeleton(bodies_->part);
  settle(start);
}

World::~World() {
  const std::lock_guard<std::mutex> lock(building());
  bodies_.reset();
}

/// Lets a free part come to rest on the still table before time starts, and refuses one that does not stand.
void World::settle(const AxesState& axes) {
  const AxesState still{axes.position, {}};
  for (int i = 0; i < kSettlingSteps; ++i) step(still, still);
  const Isometry3d change = clamped_pose_.inverse() * platter_from_part();
  const double tilt = Eigen::AngleAxisd(change.linear()).angle();
  const double shift = change.translation().norm();
  if (!(tilt < kMostTilt && shift < kMostSinking)) {
    throw DescriptionError(
        "part: the free part does not stand where part.table_from_part puts it: within 1 s it turns by " +
        std::to_string(tilt) + " rad and moves by " + std::to_string(shift) + " m");
  }
}

void World::set_axes(const AxesState& axes) {
  bodies_->arm->setPositions(Eigen::Map<const Eigen::Matrix<double, kJoints, 1>>(axes.position.data()));
  bodies_->table->setPosition(0, axes.position[kTableAxis]);
}

void World::step(const AxesState& from, const AxesState& to) {
  prepare_thread();
  set_axes(from);
  Eigen::Matrix<double, kAxes, 1> speed;
  for (int i = 0; i < kAxes; ++i) {
    const auto axis = static_cast<std::size_t>(i);
    speed[i] = (to.position[axis] - from.position[axis]) / time_step_;
  }
  bodies_->arm->setVelocities(speed.head<kJoints>());
  bodies_->table->setVelocity(0, speed[kTableAxis]);
  if (free_) orient_friction();
  bodies_->world->step();
  set_axes(to);
  if (free_) read_contact();
}

/// The solver's friction limit is a pyramid, exact along its axes alone: turn one of them into the force.
void World::orient_friction() {
  bodies_->part_body()->getShapeNode(0)->getDynamicsAspect()->setFirstFrictionDirection(friction_direction_);
}

void World::read_contact() {
  const Vector3d up = bodies_->platter()->getWorldTransform().linear().col(2);
  Vector3d total = Vector3d::Zero();
  const auto& result = bodies_->world->getConstraintSolver()->getLastCollisionResult();
  for (const auto& contact : result.getContacts()) {
    const bool part_first =
        contact.collisionObject1->getShapeFrame() == bodies_->part_body()->getShapeNode(0);
    total += part_first ? contact.force : Vector3d(-contact.force);
  }
  ContactForce force;
  force.normal = total.dot(up);
  force.tangential = total - force.normal * up;
  const double friction = force.tangential.norm();
  friction_direction_ = friction > 0 ? Vector3d(force.tangential / friction) : Vector3d::Zero();

  const Isometry3d before = platter_from_part();
  const bool was_engaged = anchor_.state().engaged;
  const Isometry3d after = anchor_.settle(before, force);
  if (was_engaged && anchor_.state().engaged) {
    bodies_->part->setPositions(
        FreeJoint::convertToPositions(bodies_->platter()->getWorldTransform() * after));
  }
}

Isometry3d World::platter_from_part() const {
  if (!free_) return clamped_pose_;
  return bodies_->platter()->getWorldTransform().inverse() * bodies_->part_body()->getWorldTransform();
}

Isometry3d World::link_pose(int link) const {
  return bodies_->arm->getBodyNode(static_cast<std::size_t>(link))->getWorldTransform();
}

FreePartState World::free_part() const {
  FreePartState state;
  if (!free_) return state;
  Eigen::Map<Eigen::Matrix<double, 6, 1>>(state.position.data()) = bodies_->part->getPositions();
  Eigen::Map<Eigen::Matrix<double, 6, 1>>(state.velocity.data()) = bodies_->part->getVelocities();
  Eigen::Map<Vector3d>(state.friction_direction.data()) = friction_direction_;
  state.anchor = anchor_.state();
  return state;
}

void World::restore(const AxesState& axes, const FreePartState& part) {
  set_axes(axes);
  if (!free_) return;
  bodies_->part->setPositions(Eigen::Map<const Eigen::Matrix<double, 6, 1>>(part.position.data()));
  bodies_->part->setVelocities(Eigen::Map<const Eigen::Matrix<double, 6, 1>>(part.velocity.data()));
  friction_direction_ = Eigen::Map<const Vector3d>(part.friction_direction.data());
  anchor_.restore(part.anchor);
}

}  // namespace robotcell
