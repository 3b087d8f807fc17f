// Small worlds of the dynamics engine for tests of contact and friction.
#pragma once

#include <dart/constraint/BoxedLcpConstraintSolver.hpp>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/BoxShape.hpp>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <dart/dynamics/WeldJoint.hpp>
#include <dart/simulation/World.hpp>
#include <memory>
#include <string>

#include "fmu/model/world/capped_collision_detector.h"

namespace robotcell::testing {

using dart::dynamics::BodyNode;
using dart::dynamics::BoxShape;
using dart::dynamics::CollisionAspect;
using dart::dynamics::DynamicsAspect;
using dart::dynamics::FreeJoint;
using dart::dynamics::Skeleton;
using dart::dynamics::SkeletonPtr;
using dart::dynamics::WeldJoint;
using Eigen::Isometry3d;
using Eigen::Vector3d;
using Eigen::Vector6d;

constexpr double kGravity = 9.80665;
constexpr double kStep = 1e-3;

inline dart::simulation::WorldPtr make_world(const dart::constraint::BoxedLcpSolverPtr& solver) {
  auto world = dart::simulation::World::create();
  world->setConstraintSolver(std::make_unique<dart::constraint::BoxedLcpConstraintSolver>(solver));
  world->getConstraintSolver()->setCollisionDetector(CappedCollisionDetector::create(4));
  world->setTimeStep(kStep);
  world->setGravity({0, 0, -kGravity});
  return world;
}

inline void add_box(BodyNode* body, const Vector3d& size, double friction) {
  auto* node = body->createShapeNodeWith<CollisionAspect, DynamicsAspect>(std::make_shared<BoxShape>(size));
  node->getDynamicsAspect()->setFrictionCoeff(friction);
}

/// A floor with its top face at z = 0.
inline SkeletonPtr add_floor(const dart::simulation::WorldPtr& world, double friction) {
  SkeletonPtr floor = Skeleton::create("floor");
  WeldJoint::Properties joint;
  joint.mT_ParentBodyToJoint = Isometry3d(Eigen::Translation3d(0, 0, -0.05));
  add_box(floor->createJointAndBodyNodePair<WeldJoint>(nullptr, joint).second, {4, 4, 0.1}, friction);
  world->addSkeleton(floor);
  return floor;
}

/// A free box of uniform density at the given centre.
inline SkeletonPtr add_free_box(const dart::simulation::WorldPtr& world, const std::string& name,
                                const Vector3d& size, double mass, double friction, const Isometry3d& pose) {
  SkeletonPtr box = Skeleton::create(name);
  BodyNode* body = box->createJointAndBodyNodePair<FreeJoint>().second;
  body->setInertia({mass, Vector3d::Zero(), BoxShape::computeInertia(size, mass)});
  add_box(body, size, friction);
  box->setPositions(FreeJoint::convertToPositions(pose));
  world->addSkeleton(box);
  return box;
}

}  // namespace robotcell::testing
