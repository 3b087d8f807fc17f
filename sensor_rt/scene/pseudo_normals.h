// Normals that tell inside from outside at faces, edges and vertices alike.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "sensor_rt/scene/mesh_shape.h"

namespace sensor_rt {

/// Where on a triangle a closest point lies: 0..2 its corners, 3..5 the edges from corner k - 3 to the next,
/// 6 inside.
constexpr int kTriangleInside = 6;

/// Angle-weighted pseudo-normals (Baerentzen and Aanaes, "Signed distance computation using the angle
/// weighted pseudonormal", IEEE TVCG 11, 2005): the sign of the distance to a closed mesh is the sign of the
/// offset along the pseudo-normal at the closest point. Vertices at the same place count as one, as in meshes
/// from STL files.
class PseudoNormals {
 public:
  explicit PseudoNormals(const MeshView& mesh);

  /// Not normalised.
  Eigen::Vector3d at(std::size_t face, int feature) const;

 private:
  std::vector<std::array<std::uint32_t, 3>> faces_;  ///< indices of welded vertices
  std::vector<Eigen::Vector3d> face_normals_;
  std::vector<Eigen::Vector3d> vertex_normals_;
  std::vector<std::array<Eigen::Vector3d, 3>> edge_normals_;  ///< per face
};

}  // namespace sensor_rt
