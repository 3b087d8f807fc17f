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

/// A part rests on its support while it slips by no more than friction stops within so many steps.
constexpr double kStepsToStop = 2;

/// A part that falls comes to rest this far away (m): at last, after hours, its place would be beyond what
/// the collision engine can count, which ends the process then.
constexpr double kFarthest = 1e4;
/// Far more than the greatest gravity makes of a fall to there (m/s, rad/s).
constexpr double kFastest = 1e6;

void stop_where_lost(Part& part) {
  const bool lost = part.pose().translation().norm() > kFarthest;
  if (lost) part.skeleton->resetVelocities();
  part.skeleton->setMobile(!lost);
}

Vector3d velocity_at(const BodyNode* body, const Vector3d& point) {
  return body->getLinearVelocity(body->getWorldTransform().inverse() * point);
}

}  // namespace

const PairContact* Part::holding(std::int32_t support) const {
  const auto found = std::find_if(contacts.begin(), contacts.end(), [support](const PairContact& contact) {
    return contact.support == support && contact.holds;
  });
  return found == contacts.end() ? nullptr : &*found;
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
      return kNothing;
  }
}

BodyNode* World::Engine::body_of(std::int32_t support) const {
  return support == kNothing ? ground->getBodyNode(0) : supports[static_cast<std::size_t>(support)].body;
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

Carrier World::Engine::carrier_of(std::int32_t support) const {
  // Parts that lean on each other may carry each other in a circle.
  for (std::size_t hops = 0; hops <= parts.size() && support != kNothing; ++hops) {
    if (const Part* part = free_part(support)) {
      support = part->carrier;
      continue;
    }
    const BodyNode* body = body_of(support);
    if (body == platter()) return Carrier::kPlatter;
    return body->getSkeleton() == arm ? Carrier::kFlange : Carrier::kWorld;
  }
  return Carrier::kWorld;
}

void World::Engine::set_most_contacts(const ContactPair& pair) {
  for (const Support& a : supports) {
    for (const Support& b : supports) {
      if (a.name != pair.bodies[0] || b.name != pair.bodies[1]) continue;
      detector->set_most_contacts(a.shape, b.shape, pair.points);
    }
  }
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
    part.rides.clear();
    if (!part.free) continue;
    stop_where_lost(part);
    part.before = part.pose();
    for (const StickAnchor& anchor : part.anchors) {
      part.rides.push_back({anchor.support, pose_of(anchor.support).inverse() * part.pose(), {}});
      if (free_part(anchor.support) == nullptr) {
        part.rides.back().jacobian = body_of(anchor.support)->getJacobian();
      }
    }
  }
}

void World::Engine::hold_parts(double time_step) {
  for (Part& part : parts) {
    part.contacts.clear();
    part.settled = !part.free;
    if (part.free) part.moved = FreeJoint::convertToPositions(part.before.inverse() * part.pose());
  }
  read_contacts();
  for (Part& part : parts) hold(part, time_step);
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

/// Splits the forces of a part's contacts and finds what carries it.
void World::Engine::weigh_contacts(Part& part, double time_step) {
  part.carrier = kNothing;
  double greatest = 0;
  for (PairContact& contact : part.contacts) {
    const Support& support = supports[static_cast<std::size_t>(contact.support)];
    contact.normal =
        support.flat ? support.body->getWorldTransform().linear().col(2) : contact.normal.normalized();
    contact.split = split(contact.force, contact.normal);
    const double friction = std::min(part.friction, support.friction);
    const double stopping_speed =
        kStepsToStop * friction * contact.split.normal / part.body()->getMass() * time_step;
    // The points of a soft part stick by themselves; where its core is to be kept, nothing says.
    contact.holds = !part.soft && !is_soft(contact.support) && friction_holds(contact.split, friction) &&
                    slip_of(part, contact).norm() < stopping_speed &&
                    spin_of(part, contact) * part.gyration < stopping_speed;
    if (contact.split.normal <= greatest) continue;
    greatest = contact.split.normal;
    part.carrier = contact.support;
  }
}

/// Slip of a part's centre of mass over a support.
Vector3d World::Engine::slip_of(const Part& part, const PairContact& contact) const {
  const BodyNode* support = body_of(contact.support);
  const Vector3d slip = part.body()->getCOMLinearVelocity() - velocity_at(support, part.body()->getCOM());
  return slip - slip.dot(contact.normal) * contact.normal;
}

double World::Engine::spin_of(const Part& part, const PairContact& contact) const {
  const Vector3d turn = part.body()->getAngularVelocity() - body_of(contact.support)->getAngularVelocity();
  return std::abs(turn.dot(contact.normal));
}

bool World::Engine::is_soft(std::int32_t support) const {
  const Part* part = free_part(support);
  return part != nullptr && part->soft;
}

/// Where a part that a support holds comes to in a step, support frame. The engine moves every body along its
/// own velocity: a part with just the velocity of the support that turns under it leaves that by half the
/// square of the step's angle times the radius, and so comes off one of two fingers, or tilts. The motion
/// relative to the support is free of that, since the velocities of both belong to their poses at the start.
Isometry3d World::Engine::carried(const Part& part, const Ride& ride, double time_step) const {
  const BodyNode* body = body_of(ride.support);
  Vector6d support_moved = Vector6d::Zero();
  if (const Part* carrier = free_part(ride.support)) {
    support_moved = carrier->moved;
  } else {
    for (std::size_t i = 0; i < body->getNumDependentGenCoords(); ++i) {
      const double speed = body->getDependentDof(i)->getVelocity();
      support_moved += ride.jacobian.col(static_cast<Eigen::Index>(i)) * (speed * time_step);
    }
  }
  const Vector6d moved = part.moved - dart::math::AdInvT(ride.support_from_part, support_moved);
  return ride.support_from_part * FreeJoint::convertToTransform(moved);
}

/// Lets go where friction does not hold, puts the part back by the strongest contact that holds (after the
/// parts that carry it), and takes hold where it has come to rest.
void World::Engine::hold(Part& part, double time_step) {
  if (part.settled) return;
  part.settled = true;
  weigh_contacts(part, time_step);
  if (Part* carrier = free_part(part.carrier)) hold(*carrier, time_step);
  auto& anchors = part.anchors;
  anchors.erase(
      std::remove_if(anchors.begin(), anchors.end(),
                     [&](const StickAnchor& anchor) { return part.holding(anchor.support) == nullptr; }),
      anchors.end());
  put_back(part, time_step);
  take_hold(part);
}

void World::Engine::put_back(Part& part, double time_step) const {
  const auto weaker = [&part](const StickAnchor& a, const StickAnchor& b) {
    return part.holding(a.support)->split.normal < part.holding(b.support)->split.normal;
  };
  const auto strongest = std::max_element(part.anchors.begin(), part.anchors.end(), weaker);
  if (strongest == part.anchors.end()) return;
  const auto ride = std::find_if(part.rides.begin(), part.rides.end(),
                                 [&](const Ride& r) { return r.support == strongest->support; });
  const Isometry3d held =
      pose_of(strongest->support) * held_pose(*strongest, carried(part, *ride, time_step));
  part.skeleton->setPositions(FreeJoint::convertToPositions(held));
}

void World::Engine::take_hold(Part& part) const {
  for (const PairContact& contact : part.contacts) {
    const bool known =
        std::any_of(part.anchors.begin(), part.anchors.end(),
                    [&contact](const StickAnchor& anchor) { return anchor.support == contact.support; });
    if (!contact.holds || known) continue;
    const Isometry3d support = pose_of(contact.support);
    part.anchors.push_back(
        {contact.support, support.linear().transpose() * contact.normal, support.inverse() * part.pose()});
  }
}

void World::Engine::check(const std::vector<FreePartState>& states) const {
  const auto known = [this](std::int32_t support) {
    return support >= kNothing && support < static_cast<std::int32_t>(supports.size());
  };
  bool fits = states.size() == parts.size();
  for (std::size_t i = 0; fits && i < states.size(); ++i) {
    const FreePartState& state = states[i];
    const std::size_t points = parts[i].soft ? soft_points(parts[i].body()).size() : 0;
    fits = known(state.carrier) && state.points.size() == points;
    for (const StickAnchor& anchor : state.anchors) fits = fits && known(anchor.support);
  }
  if (!fits) throw std::invalid_argument("the state holds parts that this cell does not have");
  for (const FreePartState& state : states) {
    const bool near = Eigen::Map<const Vector3d>(state.position.data() + 3).norm() < 2 * kFarthest;
    const bool slow = Eigen::Map<const Vector6d>(state.velocity.data()).norm() < kFastest;
    if (near && slow) continue;
    throw std::invalid_argument("the state holds a part that is farther away or faster than any can get");
  }
}

}  // namespace robotcell
