// Pairs of shapes that do not touch each other.
#pragma once

#include <dart/collision/CollisionFilter.hpp>
#include <dart/dynamics/ShapeFrame.hpp>
#include <set>
#include <utility>

namespace robotcell {

class ContactFilter : public dart::collision::CollisionFilter {
 public:
  /// Excludes contacts of two shapes.
  void ignore(const dart::dynamics::ShapeFrame* a, const dart::dynamics::ShapeFrame* b);
  bool ignores(const dart::dynamics::ShapeFrame* a, const dart::dynamics::ShapeFrame* b) const;
  bool ignoresCollision(const dart::collision::CollisionObject* a,
                        const dart::collision::CollisionObject* b) const override;

 private:
  std::set<std::pair<const dart::dynamics::ShapeFrame*, const dart::dynamics::ShapeFrame*>> ignored_;
};

}  // namespace robotcell
