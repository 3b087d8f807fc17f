#include "fmu/model/capped_collision_detector.h"

#include <algorithm>
#include <dart/collision/CollisionObject.hpp>
#include <dart/collision/CollisionResult.hpp>
#include <limits>
#include <mutex>
#include <stdexcept>
#include <utility>
#include <vector>

#include "fmu/model/engine_locks.h"

namespace robotcell {
namespace {

using dart::collision::CollisionResult;
using dart::collision::Contact;

/// m. ODE counts places in cells, and ends the process where their number is no integer any more.
constexpr double kFarthest = 1e6;

/// Throws std::runtime_error when a body is where the engine cannot go on. It is for any cause that is not
/// refused before: numbers that a caller has set, states, dynamics out of bounds.
void check_places(const dart::collision::CollisionGroup& group) {
  for (std::size_t i = 0; i < group.getNumShapeFrames(); ++i) {
    const dart::dynamics::ShapeFrame* frame = group.getShapeFrame(i);
    if ((frame->getWorldTransform().matrix().array().abs() < kFarthest).all()) continue;
    throw std::runtime_error(frame->getName() +
                             " has left the world: it is more than 1000 km away or nowhere");
  }
}

bool collide_alone(dart::collision::OdeCollisionDetector& detector, dart::collision::CollisionGroup* group,
                   const dart::collision::CollisionOption& option, CollisionResult* result) {
  check_places(*group);
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

std::vector<Contact> widest_of(std::vector<Contact> contacts, std::size_t most) {
  if (contacts.size() <= most) return contacts;
  const auto deepest = std::max_element(
      contacts.begin(), contacts.end(),
      [](const Contact& a, const Contact& b) { return a.penetrationDepth < b.penetrationDepth; });
  std::vector<Contact> kept{*deepest};
  while (kept.size() < most) {
    const auto farthest =
        std::max_element(contacts.begin(), contacts.end(), [&kept](const Contact& a, const Contact& b) {
          return distance_to_kept(a, kept) < distance_to_kept(b, kept);
        });
    kept.push_back(*farthest);
  }
  return kept;
}

}  // namespace

std::shared_ptr<CappedCollisionDetector> CappedCollisionDetector::create(std::size_t most) {
  return std::shared_ptr<CappedCollisionDetector>(new CappedCollisionDetector(most));
}

std::shared_ptr<dart::collision::CollisionDetector> CappedCollisionDetector::cloneWithoutCollisionObjects()
    const {
  auto clone = create(most_);
  clone->most_contacts_ = most_contacts_;
  return clone;
}

void CappedCollisionDetector::set_most_contacts(const dart::dynamics::ShapeFrame* a,
                                                const dart::dynamics::ShapeFrame* b, std::size_t most) {
  most_contacts_[std::minmax(a, b)] = most;
}

std::size_t CappedCollisionDetector::most_contacts(const Contact& contact) const {
  const auto found = most_contacts_.find(
      std::minmax(contact.collisionObject1->getShapeFrame(), contact.collisionObject2->getShapeFrame()));
  return found == most_contacts_.end() ? most_ : found->second;
}

bool CappedCollisionDetector::collide(dart::collision::CollisionGroup* group,
                                      const dart::collision::CollisionOption& option,
                                      CollisionResult* result) {
  if (result == nullptr) return collide_alone(*this, group, option, nullptr);
  CollisionResult all;
  const bool hit = collide_alone(*this, group, option, &all);
  result->clear();
  std::vector<Contact> rest = all.getContacts();
  while (!rest.empty()) {
    const auto other = std::stable_partition(
        rest.begin(), rest.end(), [first = rest.front()](const Contact& c) { return same_pair(first, c); });
    for (const Contact& contact : widest_of({rest.begin(), other}, most_contacts(rest.front()))) {
      result->addContact(contact);
    }
    rest.erase(rest.begin(), other);
  }
  return hit;
}

}  // namespace robotcell
