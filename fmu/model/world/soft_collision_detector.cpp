#include "fmu/model/world/soft_collision_detector.h"

#include <dart/collision/CollisionFilter.hpp>
#include <dart/collision/CollisionObject.hpp>
#include <dart/collision/CollisionResult.hpp>
#include <dart/dynamics/PointMass.hpp>
#include <dart/dynamics/SoftBodyNode.hpp>

namespace robotcell {

using dart::collision::CollisionResult;
using dart::collision::Contact;
using dart::dynamics::ShapeNode;
using dart::dynamics::SoftBodyNode;

class SoftCollisionDetector::ContactObject : public dart::collision::CollisionObject {
 public:
  ContactObject(dart::collision::CollisionDetector* detector, ShapeNode* shape)
      : CollisionObject(detector, shape), shape_(shape) {}

  const SoftBodyNode& soft() const { return *shape_->getBodyNodePtr()->asSoftBodyNode(); }

 protected:
  void updateEngineData() override {}

 private:
  ShapeNode* shape_;
};

std::shared_ptr<SoftCollisionDetector> SoftCollisionDetector::create(std::size_t max_contacts) {
  return std::shared_ptr<SoftCollisionDetector>(new SoftCollisionDetector(max_contacts));
}

void SoftCollisionDetector::add_soft(ShapeNode* soft) {
  SoftBody added{std::make_shared<ContactObject>(this, soft), {}};
  const SoftBodyNode& body = added.object->soft();
  added.face_of_point.resize(body.getNumPointMasses());
  for (std::size_t f = 0; f < body.getNumFaces(); ++f) {
    for (const int point : body.getFace(f)) {
      added.face_of_point[static_cast<std::size_t>(point)] = static_cast<int>(f);
    }
  }
  soft_.push_back(added);
}

void SoftCollisionDetector::add_obstacle(ShapeNode* obstacle) {
  obstacles_.push_back({std::make_shared<ContactObject>(this, obstacle), Solid(*obstacle->getShape())});
}

bool SoftCollisionDetector::collide(dart::collision::CollisionGroup* group,
                                    const dart::collision::CollisionOption& option, CollisionResult* result) {
  const bool found_contact = CappedCollisionDetector::collide(group, option, result);
  if (result == nullptr) return found_contact;
  for (const SoftBody& soft : soft_) {
    for (const Obstacle& obstacle : obstacles_) {
      const auto& filter = option.collisionFilter;
      if (filter && filter->ignoresCollision(soft.object.get(), obstacle.object.get())) continue;
      add_contacts(soft, obstacle, *result);
    }
  }
  return found_contact || result->isCollision();
}

void SoftCollisionDetector::add_contacts(const SoftBody& soft, const Obstacle& obstacle,
                                         CollisionResult& result) const {
  const Eigen::Isometry3d& world_from_shape = obstacle.object->getTransform();
  const Eigen::Isometry3d shape_from_world = world_from_shape.inverse();
  const SoftBodyNode& body = soft.object->soft();
  for (std::size_t i = 0; i < body.getNumPointMasses(); ++i) {
    const Eigen::Vector3d& point = body.getPointMass(i)->getWorldPosition();
    const std::optional<Depth> inside = obstacle.solid.depth(shape_from_world * point);
    if (!inside) continue;
    Contact contact;
    contact.collisionObject1 = soft.object.get();
    contact.collisionObject2 = obstacle.object.get();
    contact.point = point;
    contact.normal = world_from_shape.linear() * inside->normal;
    contact.penetrationDepth = inside->depth;
    contact.triID1 = soft.face_of_point[i];
    result.addContact(contact);
  }
}

}  // namespace robotcell
