// Which parts of a closed mesh can stand between an eye and what the eye looks at.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/scene/mesh_view.h"
#include "sensor_rt/scene/sight.h"

namespace sensor_rt {

/// A tree over the faces of a closed mesh that knows which way they face.
///
/// A line of sight between two points outside a closed surface leaves it as often as it enters it; going in
/// it meets a face turned towards the eye, going out one turned away, or the other way round on a surface
/// that is inside out. Where no face near the line is turned away, nothing of the mesh cuts it, and no ray
/// need be traced to know.
class FacingTree {
 public:
  FacingTree() = default;
  /// Of a closed mesh: `planes` one per face, relative to `centre`; `order` of the faces in space.
  FacingTree(const MeshView& mesh, const Eigen::Vector3d& centre, const std::vector<FacePlane>& planes,
             const std::vector<std::uint32_t>& order);

  bool empty() const { return levels_.empty(); }

  /// Windows that hold, as the eye sees it, everything that is turned away from the eye and may stand in a
  /// line of sight. As they are few, they may hold more than that.
  void find_turned_away(const Sight& sight, Windows& found) const;

 private:
  /// Bounds of eight nodes.
  struct Block {
    EightBoxes boxes;
    EightBoxes normals;
    float offset[EightBoxes::kCount];  ///< the largest of the faces' planes
  };

  struct Node {
    std::size_t level;
    std::uint32_t index;
    Window window;  ///< in which its parent has seen it
  };

  static std::vector<Block> empty_blocks(std::size_t nodes);
  void add_leaves(const MeshView& mesh, const Eigen::Vector3d& centre, const std::vector<FacePlane>& planes,
                  const std::vector<std::uint32_t>& order);
  void add_level();
  /// Writes those of a node's children that may hold something turned away in a line of sight; returns how
  /// many.
  std::size_t open(const Node& node, const Sight& sight, float margin, Node* children) const;

  std::vector<std::vector<Block>> levels_;  ///< from the root down; block i stands below node i
  float reach_ = 0.0f;                      ///< of the mesh from its centre, along the axes together
};

}  // namespace sensor_rt
