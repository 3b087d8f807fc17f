// A tree over the faces of a fine mesh, for whole fans of rays.
#pragma once

#include <Eigen/Dense>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/large_vector.h"
#include "sensor_rt/scene/eight_boxes.h"
#include "sensor_rt/scene/face_order.h"
#include "sensor_rt/scene/mesh_view.h"

namespace sensor_rt {

/// Corners of sixteen faces in the frame of the shape, as a structure of arrays; places that are left over
/// hold faces without area.
struct alignas(64) FaceGroup {
  static constexpr int kCount = static_cast<int>(kFacesPerLeaf);
  float corner[3][3][kCount];  ///< [corner][axis]
  std::uint32_t face[kCount];
};

/// A tree of eight branches per node over groups of faces, each of which is one piece of memory.
class FanTree {
 public:
  /// Meshes of fewer faces are left to packets of rays: a tree gains them little. From 4,000 faces on, the
  /// least that was measured, a search of its own takes less time than packets do (profiles of 1024 rays).
  static constexpr std::size_t kFine = 2000;

  FanTree() = default;
  /// `order` of the faces in space; the frame of the shape has its origin at `centre`.
  FanTree(const MeshView& mesh, const Eigen::Vector3d& centre, const std::vector<std::uint32_t>& order);

  bool empty() const { return groups_.empty(); }
  /// From the root down; block i stands below node i, and group i below node i of the last level.
  const std::vector<LargeVector<EightBoxes>>& levels() const { return levels_; }
  const LargeVector<FaceGroup>& groups() const { return groups_; }

 private:
  void add_groups(const MeshView& mesh, const Eigen::Vector3d& centre,
                  const std::vector<std::uint32_t>& order);
  void add_leaves();
  void add_level();

  std::vector<LargeVector<EightBoxes>> levels_;
  LargeVector<FaceGroup> groups_;
};

}  // namespace sensor_rt
