// ODE's collision detector with a bounded number of contacts per pair of bodies.
#pragma once

#include <cstdint>
#include <dart/collision/ode/OdeCollisionDetector.hpp>
#include <map>
#include <memory>
#include <utility>

namespace robotcell {

/// Keeps for every pair of shapes the deepest contact and those farthest apart from each other. Four contacts
/// support a body as well as two hundred do, at a fraction of the solver's time; with two, a gripped body
/// rotates about the line through them.
///
/// Contacts are bounded for each pair, and never in total as by the option: a bound on the total would
/// leave later pairs without contacts. ODE itself finds up to `kMaxFound` contacts of a pair; pairs that
/// reach it are counted, because those kept are chosen among a part of them.
class CappedCollisionDetector : public dart::collision::OdeCollisionDetector {
 public:
  static constexpr std::size_t kMaxFound = MAX_COLLIDE_RETURNS;

  /// `limit` is the maximum number of contacts of pairs without a limit of their own.
  static std::shared_ptr<CappedCollisionDetector> create(std::size_t limit);

  /// Sets the maximum number of contacts of one pair of shapes, in either order.
  void set_max_contacts(const dart::dynamics::ShapeFrame* a, const dart::dynamics::ShapeFrame* b,
                        std::size_t limit);

  /// Number of pairs, summed over all queries, with as many contacts as ODE can find.
  std::int32_t truncated() const { return truncated_; }

  std::shared_ptr<dart::collision::CollisionDetector> cloneWithoutCollisionObjects() const override;

  using OdeCollisionDetector::collide;
  bool collide(dart::collision::CollisionGroup* group, const dart::collision::CollisionOption& option,
               dart::collision::CollisionResult* result) override;

 protected:
  explicit CappedCollisionDetector(std::size_t limit) : default_max_contacts_(limit) {}

 private:
  using Pair = std::pair<const dart::dynamics::ShapeFrame*, const dart::dynamics::ShapeFrame*>;

  std::size_t max_contacts(const dart::collision::Contact& contact) const;

  std::size_t default_max_contacts_;
  std::map<Pair, std::size_t> max_contacts_;
  std::int32_t truncated_ = 0;
};

}  // namespace robotcell
