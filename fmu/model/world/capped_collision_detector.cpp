#include "fmu/model/world/capped_collision_detector.h"

#include <algorithm>
#include <dart/collision/CollisionObject.hpp>
#include <dart/collision/CollisionResult.hpp>
#include <limits>
#include <mutex>
#include <stdexcept>
#include <utility>
#include <vector>

#include "fmu/model/world/engine_locks.h"

namespace robotcell {
namespace {

using dart::collision::CollisionResult;
using dart::collision::Contact;

/// m. ODE aborts the process where a coordinate overflows the integer cells of its hash space.
constexpr double kMaxContactCoordinate = 1e6;

/// Throws std::runtime_error when a body is out of ODE's range. Parameters and states are checked elsewhere;
/// this check covers all other causes.
void check_positions(const dart::collision::CollisionGroup& group) {
  for (std::size_t i = 0; i < group.getNumShapeFrames(); ++i) {
    const dart::dynamics::ShapeFrame* frame = group.getShapeFrame(i);
    if ((frame->getWorldTransform().matrix().array().abs() < kMaxContactCoordinate).all()) continue;
    throw std::runtime_error(frame->getName() +
                             " is out of range: expected coordinates within 1000 km of the world origin");
  }
}

bool collide_locked(dart::collision::OdeCollisionDetector& detector, dart::collision::CollisionGroup* group,
                    const dart::collision::CollisionOption& option, CollisionResult* result) {
  check_positions(*group);
  const std::lock_guard<std::mutex> lock(mesh_collision_mutex());
  return detector.OdeCollisionDetector::collide(group, option, result);
}

bool same_pair(const Contact& a, const Contact& b) {
  return a.collisionObject1 == b.collisionObject1 && a.collisionObject2 == b.collisionObject2;
}

double distance_to_kept(const Contact& contact, const std::vector<Contact>& kept) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const Contact& other : kept) nearest = std::min(nearest, (contact.point - other.point).squaredNorm());
  return nearest;
}

std::vector<Contact> most_spread_contacts(const std::vector<Contact>& contacts, std::size_t limit) {
  if (contacts.size() <= limit) return contacts;
  const auto deepest = std::max_element(
      contacts.begin(), contacts.end(),
      [](const Contact& a, const Contact& b) { return a.penetrationDepth < b.penetrationDepth; });
  std::vector<Contact> kept{*deepest};
  while (kept.size() < limit) {
    const auto next =
        std::max_element(contacts.begin(), contacts.end(), [&kept](const Contact& a, const Contact& b) {
          return distance_to_kept(a, kept) < distance_to_kept(b, kept);
        });
    kept.push_back(*next);
  }
  return kept;
}

}  // namespace

std::shared_ptr<CappedCollisionDetector> CappedCollisionDetector::create(std::size_t limit) {
  return std::shared_ptr<CappedCollisionDetector>(new CappedCollisionDetector(limit));
}

std::shared_ptr<dart::collision::CollisionDetector> CappedCollisionDetector::cloneWithoutCollisionObjects()
    const {
  auto clone = create(default_max_contacts_);
  clone->max_contacts_ = max_contacts_;
  return clone;
}

void CappedCollisionDetector::set_max_contacts(const dart::dynamics::ShapeFrame* a,
                                               const dart::dynamics::ShapeFrame* b, std::size_t limit) {
  max_contacts_[std::minmax(a, b)] = limit;
}

std::size_t CappedCollisionDetector::max_contacts(const Contact& contact) const {
  const auto found = max_contacts_.find(
      std::minmax(contact.collisionObject1->getShapeFrame(), contact.collisionObject2->getShapeFrame()));
  return found == max_contacts_.end() ? default_max_contacts_ : found->second;
}

bool CappedCollisionDetector::collide(dart::collision::CollisionGroup* group,
                                      const dart::collision::CollisionOption& option,
                                      CollisionResult* result) {
  if (result == nullptr) return collide_locked(*this, group, option, nullptr);
  dart::collision::CollisionOption all_contacts = option;
  all_contacts.maxNumContacts = std::numeric_limits<std::size_t>::max();
  CollisionResult all;
  const bool found_contact = collide_locked(*this, group, all_contacts, &all);
  result->clear();
  const std::vector<Contact>& contacts = all.getContacts();
  for (auto first = contacts.begin(); first != contacts.end();) {  // those of a pair follow each other
    const auto next =
        std::find_if(first, contacts.end(), [&](const Contact& c) { return !same_pair(*first, c); });
    const std::vector<Contact> of_pair(first, next);
    if (of_pair.size() >= kMaxFound) ++truncated_;
    for (const Contact& contact : most_spread_contacts(of_pair, max_contacts(*first)))
      result->addContact(contact);
    first = next;
  }
  return found_contact;
}

}  // namespace robotcell
