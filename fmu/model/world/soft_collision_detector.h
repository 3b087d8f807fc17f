// Collision detector of cells with soft parts.
#pragma once

#include <dart/dynamics/ShapeNode.hpp>
#include <map>
#include <memory>
#include <vector>

#include "fmu/model/world/capped_collision_detector.h"
#include "fmu/model/world/solid.h"

namespace robotcell {

/// Rigid pairs are handled as in the base class. A soft part touches a rigid body wherever one of its points
/// lies inside, without a limit of contacts. Soft parts do not touch each other.
///
/// ODE has no soft bodies. The other detectors of DART treat a soft body as a triangle mesh and report
/// crossing triangles, which for two pressed faces lie at the rim, with normals along the face.
class SoftCollisionDetector : public CappedCollisionDetector {
 public:
  static std::shared_ptr<SoftCollisionDetector> create(std::size_t max_contacts);

  /// Shapes of soft bodies touch all obstacles.
  void add_soft(dart::dynamics::ShapeNode* soft);
  void add_obstacle(dart::dynamics::ShapeNode* obstacle);

  using CappedCollisionDetector::collide;
  bool collide(dart::collision::CollisionGroup* group, const dart::collision::CollisionOption& option,
               dart::collision::CollisionResult* result) override;

 private:
  /// Minimal collision object for bodies that no other detector handles.
  class ContactObject;

  struct SoftBody {
    std::shared_ptr<ContactObject> object;
    std::vector<int> face_of_point;  // one face that contains the point
  };
  struct Obstacle {
    std::shared_ptr<ContactObject> object;
    Solid solid;
  };

  explicit SoftCollisionDetector(std::size_t max_contacts) : CappedCollisionDetector(max_contacts) {}
  void add_contacts(const SoftBody& soft, const Obstacle& obstacle,
                    dart::collision::CollisionResult& result) const;

  std::vector<SoftBody> soft_;
  std::vector<Obstacle> obstacles_;
};

}  // namespace robotcell
