#include "fmu/model/world/contact_filter.h"

#include <algorithm>
#include <dart/collision/CollisionObject.hpp>

namespace robotcell {

void ContactFilter::ignore(const dart::dynamics::ShapeFrame* a, const dart::dynamics::ShapeFrame* b) {
  ignored_.insert(std::minmax(a, b));
}

bool ContactFilter::ignores(const dart::dynamics::ShapeFrame* a, const dart::dynamics::ShapeFrame* b) const {
  return ignored_.count(std::minmax(a, b)) > 0;
}

bool ContactFilter::ignoresCollision(const dart::collision::CollisionObject* a,
                                     const dart::collision::CollisionObject* b) const {
  return ignores(a->getShapeFrame(), b->getShapeFrame());
}

}  // namespace robotcell
