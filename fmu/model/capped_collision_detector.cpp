#include "fmu/model/capped_collision_detector.h"

#include <algorithm>
#include <dart/collision/CollisionResult.hpp>
#include <limits>
#include <mutex>
#include <utility>
#include <vector>

namespace robotcell {
namespace {

using dart::collision::CollisionResult;
using dart::collision::Contact;

constexpr std::size_t kMostPerPair = 4;

/// ODE as distributed keeps one mesh collider for the whole process, whatever its per-thread data promises:
/// two instances that collide meshes at once would disturb each other's contacts.
bool collide_alone(dart::collision::OdeCollisionDetector& detector, dart::collision::CollisionGroup* group,
                   const dart::collision::CollisionOption& option, CollisionResult* result) {
  static std::mutex mutex;
  const std::lock_guard<std::mutex> lock(mutex);
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

std::vector<Contact> four_of(std::vector<Contact> contacts) {
  if (contacts.size() <= kMostPerPair) return contacts;
  const auto deepest = std::max_element(
      contacts.begin(), contacts.end(),
      [](const Contact& a, const Contact& b) { return a.penetrationDepth < b.penetrationDepth; });
  std::vector<Contact> kept{*deepest};
  while (kept.size() < kMostPerPair) {
    const auto farthest =
        std::max_element(contacts.begin(), contacts.end(), [&kept](const Contact& a, const Contact& b) {
          return distance_to_kept(a, kept) < distance_to_kept(b, kept);
        });
    kept.push_back(*farthest);
  }
  return kept;
}

}  // namespace

std::shared_ptr<CappedCollisionDetector> CappedCollisionDetector::create() {
  return std::shared_ptr<CappedCollisionDetector>(new CappedCollisionDetector());
}

std::shared_ptr<dart::collision::CollisionDetector> CappedCollisionDetector::cloneWithoutCollisionObjects()
    const {
  return create();
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
    for (const Contact& contact : four_of({rest.begin(), other})) result->addContact(contact);
    rest.erase(rest.begin(), other);
  }
  return hit;
}

}  // namespace robotcell
