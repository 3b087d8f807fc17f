#include "fmu/model/world_engine.h"

#include <algorithm>
#include <dart/collision/CollisionObject.hpp>
#include <dart/constraint/ConstraintSolver.hpp>
#include <stdexcept>

#include "fmu/model/soft_body.h"

namespace robotcell {
namespace {

using dart::dynamics::BodyNode;
using dart::dynamics::FreeJoint;
using Eigen::Isometry3d;
using Eigen::Vector3d;

/// A part rests on its support while it slips by no more than friction stops within so many steps.
constexpr double kStepsToStop = 2;

Vector3d velocity_at(const BodyNode* body, const Vector3d& point) {
  return body->getLinearVelocity(body->getWorldTransform().inverse() * point);
}

}  // namespace

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

bool World::Engine::carried_by_platter(std::int32_t support) const {
  const std::size_t first_part = supports.size() - parts.size();
  // Parts that lean on each other may carry each other in a circle.
  for (std::size_t hops = 0; hops <= parts.size(); ++hops) {
    if (support == kNothing) return false;
    const auto number = static_cast<std::size_t>(support);
    if (number < first_part || !parts[number - first_part].free) return body_of(support) == platter();
    support = parts[number - first_part].carrier;
  }
  return false;
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

void World::Engine::hold_parts(double time_step) {
  for (Part& part : parts) {
    part.contacts.clear();
    part.settled = !part.free;
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
  const auto number = static_cast<std::size_t>(on);
  const std::size_t first_part = supports.size() - parts.size();
  if (number < first_part || !parts[number - first_part].free) return;
  auto& contacts = parts[number - first_part].contacts;
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

/// A part between two fingers creeps from one to the other as it creeps in their plane, although they press
/// it evenly: the way back to where it was between them when it came to rest.
Vector3d World::Engine::back_to_middle(const Part& part, const StickAnchor& anchor) const {
  const auto lifted = [&](const StickAnchor& from) {
    const Vector3d place = (pose_of(from.support).inverse() * part.pose()).translation();
    return from.normal.dot(place - from.support_from_body.translation());
  };
  if (!is_finger(anchor.support)) return Vector3d::Zero();
  for (const StickAnchor& other : part.anchors) {
    if (other.support == anchor.support || !is_finger(other.support)) continue;
    const double drift = (lifted(anchor) - lifted(other)) / 2;
    return pose_of(anchor.support).linear() * anchor.normal * -drift;
  }
  return Vector3d::Zero();
}

bool World::Engine::is_soft(std::int32_t support) const {
  const auto part = static_cast<std::size_t>(support) + parts.size() - supports.size();
  return part < parts.size() && parts[part].soft;
}

bool World::Engine::is_finger(std::int32_t support) const {
  const auto first = static_cast<std::int32_t>(1 + belts.size());
  return gripper != nullptr && support >= first && support < first + 2;
}

/// Lets go where friction does not hold, puts the part back by the strongest contact that holds (after the
/// parts that carry it), and takes hold where it has come to rest.
void World::Engine::hold(Part& part, double time_step) {
  if (part.settled) return;
  part.settled = true;
  weigh_contacts(part, time_step);
  const auto first_part = static_cast<std::int32_t>(supports.size() - parts.size());
  if (part.carrier >= first_part) hold(parts[static_cast<std::size_t>(part.carrier - first_part)], time_step);

  const auto holding = [&part](std::int32_t support) {
    const auto found =
        std::find_if(part.contacts.begin(), part.contacts.end(),
                     [support](const PairContact& c) { return c.support == support && c.holds; });
    return found == part.contacts.end() ? nullptr : &*found;
  };
  double greatest = 0;
  const StickAnchor* strongest = nullptr;
  auto& anchors = part.anchors;
  anchors.erase(std::remove_if(anchors.begin(), anchors.end(),
                               [&](const StickAnchor& anchor) { return holding(anchor.support) == nullptr; }),
                anchors.end());
  for (const StickAnchor& anchor : anchors) {
    const double normal = holding(anchor.support)->split.normal;
    if (normal <= greatest) continue;
    greatest = normal;
    strongest = &anchor;
  }
  if (strongest != nullptr) {
    const Isometry3d support = pose_of(strongest->support);
    Isometry3d held = support * held_pose(*strongest, support.inverse() * part.pose());
    held.pretranslate(back_to_middle(part, *strongest));
    part.skeleton->setPositions(FreeJoint::convertToPositions(held));
  }
  for (const PairContact& contact : part.contacts) {
    const bool known = std::any_of(anchors.begin(), anchors.end(), [&contact](const StickAnchor& anchor) {
      return anchor.support == contact.support;
    });
    if (!contact.holds || known) continue;
    const Isometry3d support = pose_of(contact.support);
    anchors.push_back(
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
}

}  // namespace robotcell
