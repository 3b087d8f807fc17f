// ODE's collision detector with a bounded number of contacts per pair of bodies.
#pragma once

#include <dart/collision/ode/OdeCollisionDetector.hpp>
#include <map>
#include <memory>
#include <utility>

namespace robotcell {

/// Keeps, of every pair, the deepest contact and those farthest apart from the ones already kept: four carry
/// a body as well as two hundred, at a fraction of the solver's time. Two let a gripped body turn about the
/// line through them, one shows no more than that there is contact.
class CappedCollisionDetector : public dart::collision::OdeCollisionDetector {
 public:
  /// With the most contacts of pairs for which nothing else is set.
  static std::shared_ptr<CappedCollisionDetector> create(std::size_t most);

  /// Most contacts of one pair of shapes, in either order.
  void set_most_contacts(const dart::dynamics::ShapeFrame* a, const dart::dynamics::ShapeFrame* b,
                         std::size_t most);

  std::shared_ptr<dart::collision::CollisionDetector> cloneWithoutCollisionObjects() const override;

  using OdeCollisionDetector::collide;
  bool collide(dart::collision::CollisionGroup* group, const dart::collision::CollisionOption& option,
               dart::collision::CollisionResult* result) override;

 protected:
  explicit CappedCollisionDetector(std::size_t most) : most_(most) {}

 private:
  using Pair = std::pair<const dart::dynamics::ShapeFrame*, const dart::dynamics::ShapeFrame*>;

  std::size_t most_contacts(const dart::collision::Contact& contact) const;

  std::size_t most_;
  std::map<Pair, std::size_t> most_contacts_;
};

}  // namespace robotcell
