#include "fmu/model/world/world_engine.h"

#include <algorithm>
#include <dart/collision/CollisionObject.hpp>
#include <dart/constraint/ConstraintSolver.hpp>
#include <stdexcept>
#include <utility>

#include "fmu/model/world/soft_body.h"

namespace robotcell {
namespace {

using dart::dynamics::BodyNode;
using dart::dynamics::FreeJoint;
using Eigen::Isometry3d;
using Eigen::Vector3d;
using Eigen::Vector6d;

/// m. A falling part is stopped here: further away its coordinates would overflow in the collision engine.
constexpr double kMaxDistance = 1e4;
/// m/s, rad/s; larger than any fall within kMaxDistance can produce.
constexpr double kMaxSpeed = 1e6;

void stop_if_out_of_range(Part& part) {
  const bool out_of_range = part.pose().translation().norm() > kMaxDistance;
  if (out_of_range) part.skeleton->resetVelocities();
  part.skeleton->setMobile(!out_of_range);
}

}  // namespace

bool World::Engine::has_free_motion() const {
  return dynamic_arm || gripper ||
         std::any_of(parts.begin(), parts.end(), [](const Part& p) { return p.free; });
}

void World::Engine::add_support(const Support& support) {
  if (support.shape != nullptr) support_of_shape_[support.shape] = static_cast<std::int32_t>(supports.size());
  supports.push_back(support);
}

BodyNode* World::Engine::body_of(std::int32_t support) const {
  return support == kNoSupport ? ground->getBodyNode(0) : supports[static_cast<std::size_t>(support)].body;
}

Isometry3d World::Engine::pose_of(std::int32_t support) const {
  Isometry3d pose = body_of(support)->getWorldTransform();
  if (support != kNoSupport) pose.translate(supports[static_cast<std::size_t>(support)].travel);
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

std::size_t World::Engine::frame_of(std::int32_t support) const {
  // Parts that lean on each other may form a cycle.
  for (std::size_t hops = 0; hops <= parts.size() && support != kNoSupport; ++hops) {
    const Part* part = free_part(support);
    if (part == nullptr) return supports[static_cast<std::size_t>(support)].frame;
    support = part->main_support;
  }
  return kWorld;
}

bool World::Engine::moves_by_forces(const Support& support) const {
  const auto skeleton = support.body->getSkeleton();
  if (skeleton != arm) return skeleton->isMobile();
  return dynamic_arm && support.body->getIndexInSkeleton() >= first_link;
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
    const BodyNode *body_a = supports[a].body, *body_b = supports[b].body;
    const BodyNode *base = frames[base_carrier].body, *link1 = link(0);
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
    if (part.free) stop_if_out_of_range(part);
  }
  if (stick) begin_stick_step(*this);
}

void World::Engine::end_step(double time_step) {
  read_contacts();
  for (Part& part : parts) split_forces(part);
  if (stick) apply_stick_constraints(*this, time_step);
}

void World::Engine::read_contacts() {
  point_contacts.clear();
  for (Part& part : parts) part.contacts.clear();
  for (const auto& contact : world->getConstraintSolver()->getLastCollisionResult().getContacts()) {
    const std::int32_t first = support_of_shape_.at(contact.collisionObject1->getShapeFrame());
    const std::int32_t second = support_of_shape_.at(contact.collisionObject2->getShapeFrame());
    add_contact({first, second, contact.point, contact.force}, contact.normal);
    add_contact({second, first, contact.point, -contact.force}, -contact.normal);
  }
}

void World::Engine::add_contact(const PointContact& contact, const Vector3d& normal) {
  Part* part = free_part(contact.on);
  if (part == nullptr) return;
  point_contacts.push_back(contact);
  auto& contacts = part->contacts;
  auto pair = std::find_if(contacts.begin(), contacts.end(),
                           [&contact](const PairContact& c) { return c.support == contact.by; });
  if (pair == contacts.end()) {
    pair = contacts.insert(contacts.end(), PairContact());
    pair->support = contact.by;
  }
  pair->force += contact.force;
  pair->normal += normal;
}

/// Splits the contact forces of a part, and finds its main support.
void World::Engine::split_forces(Part& part) const {
  part.main_support = kNoSupport;
  double max_normal_force = 0;
  for (PairContact& contact : part.contacts) {
    const Support& support = supports[static_cast<std::size_t>(contact.support)];
    contact.normal =
        support.flat ? support.body->getWorldTransform().linear().col(2) : contact.normal.normalized();
    contact.split = split(contact.force, contact.normal);
    if (contact.split.normal <= max_normal_force) continue;
    max_normal_force = contact.split.normal;
    part.main_support = contact.support;
  }
}

bool World::Engine::is_soft(std::int32_t support) const {
  const Part* part = free_part(support);
  return part != nullptr && part->soft;
}

void World::Engine::check(const std::vector<FreePartState>& states) const {
  const auto known = [this](std::int32_t support) {
    return support >= kNoSupport && support < static_cast<std::int32_t>(supports.size());
  };
  bool fits = states.size() == parts.size();
  for (std::size_t i = 0; fits && i < states.size(); ++i) {
    const FreePartState& state = states[i];
    const std::size_t points = parts[i].soft ? soft_points(parts[i].body()).size() : 0;
    fits =
        known(state.main_support) && known(state.stick_constraint.support) && state.points.size() == points;
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
