#include "fmu/model/world_engine.h"

#include <algorithm>
#include <dart/collision/CollisionObject.hpp>
#include <dart/constraint/ConstraintSolver.hpp>
#include <stdexcept>
#include <utility>

#include "fmu/model/soft_body.h"

namespace robotcell {
namespace {

using dart::dynamics::BodyNode;
using dart::dynamics::FreeJoint;
using Eigen::Isometry3d;
using Eigen::Vector3d;
using Eigen::Vector6d;

/// A part sticks while its slip velocity is below what friction stops within this number of steps.
constexpr double kStepsToStop = 2;

/// m. A falling part is stopped here: further away its coordinates would overflow in the collision engine.
constexpr double kMaxDistance = 1e4;
/// m/s, rad/s; larger than any fall within kMaxDistance can produce.
constexpr double kMaxSpeed = 1e6;

void stop_if_out_of_range(Part& part) {
  const bool out_of_range = part.pose().translation().norm() > kMaxDistance;
  if (out_of_range) part.skeleton->resetVelocities();
  part.skeleton->setMobile(!out_of_range);
}

Vector3d velocity_at(const BodyNode* body, const Vector3d& point) {
  return body->getLinearVelocity(body->getWorldTransform().inverse() * point);
}

}  // namespace

const PairContact* Part::sticking_contact(std::int32_t support) const {
  const auto found = std::find_if(contacts.begin(), contacts.end(), [support](const PairContact& contact) {
    return contact.support == support && contact.sticks;
  });
  return found == contacts.end() ? nullptr : &*found;
}

bool World::Engine::has_free_motion() const {
  return dynamic_arm || gripper ||
         std::any_of(parts.begin(), parts.end(), [](const Part& p) { return p.free; });
}

void World::Engine::add_support(const Support& support) {
  if (support.shape != nullptr) support_of_shape_[support.shape] = static_cast<std::int32_t>(supports.size());
  supports.push_back(support);
}

std::int32_t World::Engine::support_number(const StandsOn& stands_on) {
  switch (stands_on.kind) {
    case StandsOn::Kind::kTable:
      return kTableSupport;
    case StandsOn::Kind::kConveyor:
      return static_cast<std::int32_t>(1 + stands_on.conveyor);
    default:
      return kNoSupport;
  }
}

BodyNode* World::Engine::body_of(std::int32_t support) const {
  return support == kNoSupport ? ground->getBodyNode(0) : supports[static_cast<std::size_t>(support)].body;
}

Isometry3d World::Engine::pose_of(std::int32_t support) const {
  Isometry3d pose = body_of(support)->getWorldTransform();
  const auto belt = static_cast<std::size_t>(support - 1);
  if (support > kTableSupport && belt < travel.size()) pose.translate(Vector3d(travel[belt], 0, 0));
  return pose;
}

const Part* World::Engine::free_part(std::int32_t support) const {
  const auto first_part = static_cast<std::int32_t>(supports.size() - parts.size());
  if (support < first_part) return nullptr;
  const Part& part = parts[static_cast<std::size_t>(support - first_part)];
  return part.free ? &part : nullptr;
}

Part* World::Engine::free_part(std::int32_t support) {
  return const_cast<Part*>(std::as_const(*this).free_part(support));
}

SupportingBody World::Engine::supporting_body_of(std::int32_t support) const {
  // Parts that lean on each other may form a cycle.
  for (std::size_t hops = 0; hops <= parts.size() && support != kNoSupport; ++hops) {
    if (const Part* part = free_part(support)) {
      support = part->main_support;
      continue;
    }
    const BodyNode* body = body_of(support);
    if (body == platter()) return SupportingBody::kPlatter;
    const BodyNode* flange = arm->getBodyNode(kJoints - 1);
    const bool on_flange = body == flange || body->getParentBodyNode() == flange;
    return on_flange ? SupportingBody::kFlange : SupportingBody::kWorld;
  }
  return SupportingBody::kWorld;
}

bool World::Engine::moves_by_forces(const Support& support) const {
  const auto skeleton = support.body->getSkeleton();
  return skeleton == arm ? dynamic_arm != nullptr : skeleton->isMobile();
}

int World::Engine::number_in_chain(const BodyNode* body) {
  int number = -1;
  for (; body != nullptr; body = body->getParentBodyNode()) ++number;
  return number;
}

bool World::Engine::can_touch(const Support& a, const Support& b) const {
  if (a.body == b.body || !(moves_by_forces(a) || moves_by_forces(b))) return false;
  const bool both_in_arm = a.body->getSkeleton() == arm && b.body->getSkeleton() == arm;
  return !both_in_arm || std::abs(number_in_chain(a.body) - number_in_chain(b.body)) > 1;
}

void World::Engine::exclude_contacts() {
  filter = std::make_shared<ContactFilter>();
  world->getConstraintSolver()->getCollisionOption().collisionFilter = filter;
  for (const Support& a : supports) {
    for (const Support& b : supports) {
      if (!can_touch(a, b)) filter->ignore(a.shape, b.shape);
    }
  }
}

void World::Engine::apply(const ContactPair& pair) {
  for (const Support& a : supports) {
    for (const Support& b : supports) {
      if (a.name != pair.bodies[0] || b.name != pair.bodies[1]) continue;
      detector->set_max_contacts(a.shape, b.shape, pair.points);
      if (!pair.response) filter->ignore(a.shape, b.shape);
    }
  }
}

std::string World::Engine::exclude_intersecting_bodies() {
  const auto solver = world->getConstraintSolver();
  dart::collision::CollisionResult result;
  solver->getCollisionGroup()->collide(solver->getCollisionOption(), &result);
  const std::size_t first_part = supports.size() - parts.size();
  std::string names;
  for (const dart::collision::Contact& contact : result.getContacts()) {
    const auto* shape_a = contact.collisionObject1->getShapeFrame();
    const auto* shape_b = contact.collisionObject2->getShapeFrame();
    const auto a = static_cast<std::size_t>(support_of_shape_.at(shape_a));
    const auto b = static_cast<std::size_t>(support_of_shape_.at(shape_b));
    if (a >= first_part || b >= first_part || filter->ignores(shape_a, shape_b)) continue;
    filter->ignore(shape_a, shape_b);
    const BodyNode *body_a = supports[a].body, *body_b = supports[b].body, *base = ground->getBodyNode(0);
    const BodyNode* link1 = arm->getBodyNode(0);
    if ((body_a == base && body_b == link1) || (body_a == link1 && body_b == base)) continue;
    names += (names.empty() ? "" : ", ") + supports[a].name + " and " + supports[b].name;
  }
  return names;
}

void World::Engine::connect_soft_parts(SoftCollisionDetector& soft) const {
  for (std::size_t i = 0; i < supports.size(); ++i) {
    if (supports[i].shape == nullptr) continue;
    if (is_soft(static_cast<std::int32_t>(i))) {
      soft.add_soft(supports[i].shape);
    } else {
      soft.add_obstacle(supports[i].shape);
    }
  }
}

std::pair<double, Vector3d> World::Engine::pad_force(std::size_t finger) const {
  std::pair<double, Vector3d> force(0, Vector3d::Zero());
  const auto support = static_cast<std::int32_t>(1 + belts.size() + finger);
  for (const Part& part : parts) {
    for (const PairContact& contact : part.contacts) {
      if (contact.support != support) continue;
      force.first += contact.split.normal;
      force.second += contact.force;
    }
  }
  return force;
}

void World::Engine::begin_step() {
  for (Part& part : parts) {
    part.support_poses.clear();
    if (!part.free) continue;
    stop_if_out_of_range(part);
    part.before = part.pose();
    for (const StickConstraint& constraint : part.stick_constraints) {
      part.support_poses.push_back(
          {constraint.support, pose_of(constraint.support).inverse() * part.pose(), {}});
      if (free_part(constraint.support) == nullptr) {
        part.support_poses.back().jacobian = body_of(constraint.support)->getJacobian();
      }
    }
  }
}

void World::Engine::apply_stick_constraints(double time_step) {
  for (Part& part : parts) {
    part.contacts.clear();
    part.updated = !part.free;
    if (part.free) part.displacement = FreeJoint::convertToPositions(part.before.inverse() * part.pose());
  }
  read_contacts();
  for (Part& part : parts) update_stick_constraints(part, time_step);
}

void World::Engine::read_contacts() {
  for (const auto& contact : world->getConstraintSolver()->getLastCollisionResult().getContacts()) {
    const std::int32_t first = support_of_shape_.at(contact.collisionObject1->getShapeFrame());
    const std::int32_t second = support_of_shape_.at(contact.collisionObject2->getShapeFrame());
    add_contact(first, second, contact.force, contact.normal);
    add_contact(second, first, -contact.force, -contact.normal);
  }
}

void World::Engine::add_contact(std::int32_t on, std::int32_t by, const Vector3d& force,
                                const Vector3d& normal) {
  Part* part = free_part(on);
  if (part == nullptr) return;
  auto& contacts = part->contacts;
  auto pair =
      std::find_if(contacts.begin(), contacts.end(), [by](const PairContact& c) { return c.support == by; });
  if (pair == contacts.end()) {
    pair = contacts.insert(contacts.end(), PairContact());
    pair->support = by;
  }
  pair->force += force;
  pair->normal += normal;
}

/// Splits the contact forces of a part, finds those within the friction cone, and the main support.
void World::Engine::classify_contacts(Part& part, double time_step) {
  part.main_support = kNoSupport;
  double max_normal_force = 0;
  for (PairContact& contact : part.contacts) {
    const Support& support = supports[static_cast<std::size_t>(contact.support)];
    contact.normal =
        support.flat ? support.body->getWorldTransform().linear().col(2) : contact.normal.normalized();
    contact.split = split(contact.force, contact.normal);
    const double friction = std::min(part.friction, support.friction);
    const double stopping_speed =
        kStepsToStop * friction * contact.split.normal / part.body()->getMass() * time_step;
    // The points of a soft part have friction of their own; its core has no defined rest pose.
    contact.sticks = !part.soft && !is_soft(contact.support) &&
                     within_friction_cone(contact.split, friction) &&
                     slip_velocity(part, contact).norm() < stopping_speed &&
                     spin_rate(part, contact) * part.radius_of_gyration < stopping_speed;
    if (contact.split.normal <= max_normal_force) continue;
    max_normal_force = contact.split.normal;
    part.main_support = contact.support;
  }
}

/// Tangential velocity of a part's centre of mass relative to a support.
Vector3d World::Engine::slip_velocity(const Part& part, const PairContact& contact) const {
  const BodyNode* support = body_of(contact.support);
  const Vector3d slip = part.body()->getCOMLinearVelocity() - velocity_at(support, part.body()->getCOM());
  return slip - slip.dot(contact.normal) * contact.normal;
}

double World::Engine::spin_rate(const Part& part, const PairContact& contact) const {
  const Vector3d relative_rate =
      part.body()->getAngularVelocity() - body_of(contact.support)->getAngularVelocity();
  return std::abs(relative_rate.dot(contact.normal));
}

bool World::Engine::is_soft(std::int32_t support) const {
  const Part* part = free_part(support);
  return part != nullptr && part->soft;
}

/// Pose of a sticking part relative to its support after the step.
///
/// The engine moves every body along its own velocity. A part with the velocity of a rotating support leaves
/// it in one step by half the square of the rotation angle times the radius, and so loses contact with one of
/// two fingers, or tilts. The motion relative to the support has no such error, because both velocities
/// belong to the poses at the start of the step.
Isometry3d World::Engine::relative_pose_after_step(const Part& part, const SupportPose& support_pose,
                                                   double time_step) const {
  const BodyNode* body = body_of(support_pose.support);
  Vector6d support_moved = Vector6d::Zero();
  if (const Part* main_support = free_part(support_pose.support)) {
    support_moved = main_support->displacement;
  } else {
    for (std::size_t i = 0; i < body->getNumDependentGenCoords(); ++i) {
      const double speed = body->getDependentDof(i)->getVelocity();
      support_moved += support_pose.jacobian.col(static_cast<Eigen::Index>(i)) * (speed * time_step);
    }
  }
  const Vector6d displacement =
      part.displacement - dart::math::AdInvT(support_pose.support_from_part, support_moved);
  return support_pose.support_from_part * FreeJoint::convertToTransform(displacement);
}

/// Releases constraints outside the friction cone, projects the part onto that with the largest normal force
/// (after the parts that support it), and engages new ones where it has come to rest.
void World::Engine::update_stick_constraints(Part& part, double time_step) {
  if (part.updated) return;
  part.updated = true;
  classify_contacts(part, time_step);
  if (Part* main_support = free_part(part.main_support)) update_stick_constraints(*main_support, time_step);
  auto& stick_constraints = part.stick_constraints;
  stick_constraints.erase(std::remove_if(stick_constraints.begin(), stick_constraints.end(),
                                         [&](const StickConstraint& constraint) {
                                           return part.sticking_contact(constraint.support) == nullptr;
                                         }),
                          stick_constraints.end());
  project_to_stick_constraint(part, time_step);
  engage_stick_constraints(part);
}

void World::Engine::project_to_stick_constraint(Part& part, double time_step) const {
  const auto weaker = [&part](const StickConstraint& a, const StickConstraint& b) {
    return part.sticking_contact(a.support)->split.normal < part.sticking_contact(b.support)->split.normal;
  };
  const auto strongest =
      std::max_element(part.stick_constraints.begin(), part.stick_constraints.end(), weaker);
  if (strongest == part.stick_constraints.end()) return;
  const auto support_pose =
      std::find_if(part.support_poses.begin(), part.support_poses.end(),
                   [&](const SupportPose& r) { return r.support == strongest->support; });
  const Isometry3d projected =
      pose_of(strongest->support) *
      project_pose(*strongest, relative_pose_after_step(part, *support_pose, time_step));
  part.skeleton->setPositions(FreeJoint::convertToPositions(projected));
}

void World::Engine::engage_stick_constraints(Part& part) const {
  for (const PairContact& contact : part.contacts) {
    const bool known = std::any_of(
        part.stick_constraints.begin(), part.stick_constraints.end(),
        [&contact](const StickConstraint& constraint) { return constraint.support == contact.support; });
    if (!contact.sticks || known) continue;
    const Isometry3d support = pose_of(contact.support);
    part.stick_constraints.push_back(
        {contact.support, support.linear().transpose() * contact.normal, support.inverse() * part.pose()});
  }
}

void World::Engine::check(const std::vector<FreePartState>& states) const {
  const auto known = [this](std::int32_t support) {
    return support >= kNoSupport && support < static_cast<std::int32_t>(supports.size());
  };
  bool fits = states.size() == parts.size();
  for (std::size_t i = 0; fits && i < states.size(); ++i) {
    const FreePartState& state = states[i];
    const std::size_t points = parts[i].soft ? soft_points(parts[i].body()).size() : 0;
    fits = known(state.main_support) && state.points.size() == points;
    for (const StickConstraint& constraint : state.stick_constraints) {
      fits = fits && known(constraint.support);
    }
  }
  if (!fits) throw std::invalid_argument("the state belongs to a cell with other parts");
  for (const FreePartState& state : states) {
    const bool in_range = Eigen::Map<const Vector3d>(state.position.data() + 3).norm() < 2 * kMaxDistance;
    const bool below_max_speed = Eigen::Map<const Vector6d>(state.velocity.data()).norm() < kMaxSpeed;
    if (in_range && below_max_speed) continue;
    throw std::invalid_argument("the state holds a part with an impossible position or velocity");
  }
}

}  // namespace robotcell
