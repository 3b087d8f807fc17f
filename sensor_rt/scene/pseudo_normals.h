// Pseudo-normals of faces, edges and vertices, for inside/outside tests.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "sensor_rt/scene/mesh_shape.h"

namespace sensor_rt {

/// Feature of a triangle that holds a closest point: 0..2 its corners, 3..5 the edges from corner k - 3 to
/// the next, 6 the interior.
constexpr int kTriangleInside = 6;

/// Angle-weighted pseudo-normals (Baerentzen and Aanaes, "Signed distance computation using the angle
/// weighted pseudonormal", IEEE TVCG 11, 2005): the sign of the distance to a closed mesh is the sign of the
/// offset along the pseudo-normal at the closest point. Vertices with equal coordinates are welded, as needed
/// for meshes from STL files.
class PseudoNormals {
 public:
  explicit PseudoNormals(const MeshView& mesh);

  /// Returns the pseudo-normal of a feature, not normalised.
  Eigen::Vector3d at(std::size_t face, int feature) const;

 private:
  std::vector<std::array<std::uint32_t, 3>> faces_;  ///< indices of welded vertices
  std::vector<Eigen::Vector3d> face_normals_;
  std::vector<Eigen::Vector3d> vertex_normals_;
  /// Half-edge k of face f has index 3 f + k; the half-edges of an edge form a ring, in which this is the
  /// next one.
  std::vector<std::uint32_t> next_half_edge_;

  void link_half_edges();
};

}  // namespace sensor_rt
