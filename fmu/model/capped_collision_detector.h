// ODE's collision detector with at most four contacts per pair of bodies.
#pragma once

#include <dart/collision/ode/OdeCollisionDetector.hpp>
#include <memory>

namespace robotcell {

/// Keeps, of every pair, the deepest contact and those farthest apart from the ones already kept: four carry
/// a body as well as two hundred, at a fraction of the solver's time.
class CappedCollisionDetector : public dart::collision::OdeCollisionDetector {
 public:
  static std::shared_ptr<CappedCollisionDetector> create();

  std::shared_ptr<dart::collision::CollisionDetector> cloneWithoutCollisionObjects() const override;

  using OdeCollisionDetector::collide;
  bool collide(dart::collision::CollisionGroup* group, const dart::collision::CollisionOption& option,
               dart::collision::CollisionResult* result) override;

 private:
  CappedCollisionDetector() = default;
};

}  // namespace robotcell
