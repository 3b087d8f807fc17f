#include "fmu/model/world/stick_constraint.h"

#include <algorithm>
#include <cmath>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/FreeJoint.hpp>

#include "fmu/model/world/world_engine.h"

namespace robotcell {
namespace {

using dart::dynamics::BodyNode;
using dart::dynamics::FreeJoint;
using Eigen::Isometry3d;
using Eigen::Vector3d;
using Eigen::Vector6d;
using Engine = World::Engine;

/// Fraction of the friction limit up to which a body sticks: the solver approaches its limit from below.
constexpr double kFrictionLimitMargin = 0.995;

/// A part sticks while its slip velocity is below what friction stops within this number of steps.
constexpr double kStepsToStop = 2;

/// Rotation angle about an axis from `from` to `to` (swing-twist decomposition).
double twist_angle(const Vector3d& axis, const Eigen::Matrix3d& from, const Eigen::Matrix3d& to) {
  const Eigen::Quaterniond change(to * from.transpose());
  return 2 * std::atan2(change.vec().dot(axis), change.w());
}

/// Tangential velocity of a part's centre of mass relative to a support.
Vector3d slip_velocity(const Engine& engine, const Part& part, const PairContact& contact) {
  const BodyNode* support = engine.body_of(contact.support);
  const Vector3d point = support->getWorldTransform().inverse() * part.body()->getCOM();
  const Vector3d slip = part.body()->getCOMLinearVelocity() - support->getLinearVelocity(point);
  return slip - slip.dot(contact.normal) * contact.normal;
}

double spin_rate(const Engine& engine, const Part& part, const PairContact& contact) {
  const Vector3d relative_rate =
      part.body()->getAngularVelocity() - engine.body_of(contact.support)->getAngularVelocity();
  return std::abs(relative_rate.dot(contact.normal));
}

/// Load of the contact points between a part and a support.
PatchLoad patch_load(const Engine& engine, const Part& part, const PairContact& contact, double friction) {
  const auto in_patch = [&](const PointContact& point) {
    return point.by == contact.support && engine.free_part(point.on) == &part;
  };
  const auto pressure = [&contact](const PointContact& p) { return p.force.dot(contact.normal); };
  Vector3d centre = Vector3d::Zero();
  for (const PointContact& p : engine.point_contacts) {
    if (in_patch(p)) centre += pressure(p) / contact.split.normal * p.point;
  }
  double moment = 0;
  double limit = 0;
  for (const PointContact& p : engine.point_contacts) {
    if (!in_patch(p)) continue;
    const Vector3d arm = p.point - centre;
    moment += arm.cross(p.force).dot(contact.normal);
    limit += friction * pressure(p) * (arm - arm.dot(contact.normal) * contact.normal).norm();
  }
  PatchLoad load;
  load.force = contact.split.tangential.norm() / (friction * contact.split.normal);
  // A single point transmits no moment about its normal.
  load.torsion = limit > 0 ? std::abs(moment) / limit : 0;
  return load;
}

bool sticks(const Engine& engine, const Part& part, const PairContact& contact, double time_step) {
  const Support& support = engine.supports[static_cast<std::size_t>(contact.support)];
  const double friction = std::min(part.friction, support.friction);
  // The points of a soft part have friction of their own; its core has no defined rest pose.
  if (part.soft || engine.is_soft(contact.support)) return false;
  if (!within_friction_cone(contact.split, friction)) return false;
  if (!friction_holds(patch_load(engine, part, contact, friction))) return false;
  const double stopping_speed =
      kStepsToStop * friction * contact.split.normal / part.body()->getMass() * time_step;
  return slip_velocity(engine, part, contact).norm() < stopping_speed &&
         spin_rate(engine, part, contact) * part.radius_of_gyration < stopping_speed;
}

/// Pose of a sticking part relative to its support after the step.
///
/// The engine moves every body along its own velocity. A part with the velocity of a rotating support leaves
/// it in one step by half the square of the rotation angle times the radius, and so loses contact with one of
/// two fingers, or tilts. The motion relative to the support has no such error, because both velocities
/// belong to the poses at the start of the step.
Isometry3d relative_pose_after_step(const Engine& engine, const Part& part, double time_step) {
  const StickState& stick = part.stick;
  const BodyNode* body = engine.body_of(stick.constraint.support);
  Vector6d support_moved = Vector6d::Zero();
  if (const Part* support = engine.free_part(stick.constraint.support)) {
    support_moved = support->stick.displacement;
  } else {
    for (std::size_t i = 0; i < body->getNumDependentGenCoords(); ++i) {
      const double speed = body->getDependentDof(i)->getVelocity();
      support_moved += stick.support_jacobian.col(static_cast<Eigen::Index>(i)) * (speed * time_step);
    }
  }
  const Vector6d displacement =
      stick.displacement - dart::math::AdInvT(stick.support_from_part, support_moved);
  return stick.support_from_part * FreeJoint::convertToTransform(displacement);
}

void project_part(const Engine& engine, Part& part, double time_step) {
  const StickConstraint& constraint = part.stick.constraint;
  const Isometry3d projected = engine.pose_of(constraint.support) *
                               project_pose(constraint, relative_pose_after_step(engine, part, time_step));
  part.skeleton->setPositions(FreeJoint::convertToPositions(projected));
}

/// Constraint at the present pose on the support with the largest normal force on which a part sticks.
StickConstraint engaged(const Engine& engine, const Part& part) {
  const PairContact* strongest = nullptr;
  for (const PairContact& contact : part.contacts) {
    if (!contact.sticks) continue;
    if (strongest == nullptr || contact.split.normal > strongest->split.normal) strongest = &contact;
  }
  if (strongest == nullptr) return {};
  const Isometry3d support = engine.pose_of(strongest->support);
  return {strongest->support, support.linear().transpose() * strongest->normal,
          support.inverse() * part.pose()};
}

/// Projects a part where friction still holds it, after the part that supports it; engages another constraint
/// otherwise.
void update_constraint(Engine& engine, Part& part, double time_step) {
  if (part.stick.updated) return;
  part.stick.updated = true;
  for (PairContact& contact : part.contacts) contact.sticks = sticks(engine, part, contact, time_step);
  const std::int32_t support = part.stick.constraint.support;
  for (const std::int32_t number : {part.main_support, support}) {
    if (Part* below = engine.free_part(number)) update_constraint(engine, *below, time_step);
  }
  const bool held = std::any_of(part.contacts.begin(), part.contacts.end(),
                                [support](const PairContact& c) { return c.support == support && c.sticks; });
  if (held) {
    project_part(engine, part, time_step);
  } else {
    part.stick.constraint = engaged(engine, part);
  }
}

}  // namespace

ContactForce split(const Vector3d& force, const Vector3d& normal) {
  const double along = force.dot(normal);
  return {along, force - along * normal};
}

bool within_friction_cone(const ContactForce& force, double friction) {
  return force.normal > 0 && force.tangential.norm() < kFrictionLimitMargin * friction * force.normal;
}

bool friction_holds(const PatchLoad& load) {
  return std::hypot(load.force, load.torsion) < kFrictionLimitMargin;
}

Isometry3d project_pose(const StickConstraint& constraint, const Isometry3d& support_from_body) {
  const Vector3d& n = constraint.normal;
  const double twist = twist_angle(n, constraint.support_from_body.linear(), support_from_body.linear());
  const Vector3d lift = support_from_body.translation() - constraint.support_from_body.translation();
  Isometry3d projected = support_from_body;
  projected.linear() = Eigen::AngleAxisd(-twist, n) * support_from_body.linear();
  projected.translation() = constraint.support_from_body.translation() + lift.dot(n) * n;
  return projected;
}

void begin_stick_step(Engine& engine) {
  for (Part& part : engine.parts) {
    if (!part.free) continue;
    StickState& stick = part.stick;
    stick.before = part.pose();
    const std::int32_t support = stick.constraint.support;
    if (support == kNoSupport) continue;
    stick.support_from_part = engine.pose_of(support).inverse() * part.pose();
    if (engine.free_part(support) == nullptr) {
      stick.support_jacobian = engine.body_of(support)->getJacobian();
    }
  }
}

void apply_stick_constraints(Engine& engine, double time_step) {
  for (Part& part : engine.parts) {
    part.stick.updated = !part.free;
    if (!part.free) continue;
    part.stick.displacement = FreeJoint::convertToPositions(part.stick.before.inverse() * part.pose());
  }
  for (Part& part : engine.parts) update_constraint(engine, part, time_step);
}

}  // namespace robotcell
