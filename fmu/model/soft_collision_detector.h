// The collision detector of cells with soft parts.
#pragma once

#include <dart/dynamics/ShapeNode.hpp>
#include <map>
#include <memory>
#include <vector>

#include "fmu/model/capped_collision_detector.h"
#include "fmu/model/solid.h"

namespace robotcell {

/// Rigid bodies touch each other as ever; a soft part touches a rigid one wherever one of its points lies in
/// it, in any number of contacts. Soft parts do not touch each other.
///
/// ODE knows no soft bodies. The engine's other detectors take a soft body for a triangle mesh and report
/// where its triangles cross those of the rigid body, which for two faces that press on each other is at
/// their rim, with normals along the face.
class SoftCollisionDetector : public CappedCollisionDetector {
 public:
  static std::shared_ptr<SoftCollisionDetector> create(std::size_t most);

  /// The shape of a soft body touches all obstacles.
  void add_soft(dart::dynamics::ShapeNode* soft);
  void add_obstacle(dart::dynamics::ShapeNode* obstacle);

  using CappedCollisionDetector::collide;
  bool collide(dart::collision::CollisionGroup* group, const dart::collision::CollisionOption& option,
               dart::collision::CollisionResult* result) override;

 private:
  /// What the engine wants to know of a body that no other detector knows.
  class Touching;

  struct SoftBody {
    std::shared_ptr<Touching> object;
    std::vector<int> face_of_point;  // one of the faces that a point belongs to
  };
  struct Obstacle {
    std::shared_ptr<Touching> object;
    Solid solid;
  };

  explicit SoftCollisionDetector(std::size_t most) : CappedCollisionDetector(most) {}
  void touch(const SoftBody& soft, const Obstacle& obstacle, dart::collision::CollisionResult& result) const;

  std::vector<SoftBody> soft_;
  std::vector<Obstacle> obstacles_;
};

}  // namespace robotcell
