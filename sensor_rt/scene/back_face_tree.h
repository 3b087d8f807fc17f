// Bounding volume hierarchy for back-face queries on a closed mesh.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/scene/mesh_view.h"
#include "sensor_rt/scene/shaft_culler.h"

namespace sensor_rt {

/// Bounding volume hierarchy over the faces of a closed mesh, with bounds of their normals.
///
/// A segment between two points outside a closed surface leaves the solid as often as it enters it; it
/// crosses front faces on entering and back faces on leaving, or the reverse on an inverted mesh. Where no
/// face near the segment is back-facing, the mesh cannot occlude it, and no ray has to be traced.
class BackFaceTree {
 public:
  BackFaceTree() = default;
  /// Builds the tree of a closed mesh. `planes`: one per face, relative to `centre`; `order`: spatial order
  /// of the faces.
  BackFaceTree(const MeshView& mesh, const Eigen::Vector3d& centre, const std::vector<FacePlane>& planes,
               const std::vector<std::uint32_t>& order);

  bool empty() const { return levels_.empty(); }

  /// Finds the projected bounds of all back faces that may lie within the shafts of the culler. Their number
  /// is limited, so they are conservative.
  void find_back_faces(const ShaftCuller& culler, ProjectedBoundsSet& found) const;

 private:
  /// Bounds of eight child nodes.
  struct Block {
    Aabb8 boxes;
    Aabb8 normals;
    float offset[Aabb8::kCount];  ///< largest plane offset of the faces
  };

  struct Node {
    std::size_t level;
    std::uint32_t index;
    ProjectedBounds bounds;  ///< projected bounds of the node
  };

  static std::vector<Block> empty_blocks(std::size_t nodes);
  void add_leaves(const MeshView& mesh, const Eigen::Vector3d& centre, const std::vector<FacePlane>& planes,
                  const std::vector<std::uint32_t>& order);
  void add_level();
  /// Writes the children of a node that may contain back faces within the shafts; returns their number.
  std::size_t expand(const Node& node, const ShaftCuller& culler, float margin, Node* children) const;

  std::vector<std::vector<Block>> levels_;  ///< from the root down; block i holds the children of node i
  float reach_ = 0.0f;                      ///< bound of the L1 distance of a vertex from the centre
};

}  // namespace sensor_rt
