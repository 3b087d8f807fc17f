// Exact closest-point queries on a triangle mesh.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/scene/mesh_shape.h"
#include "sensor_rt/scene/pseudo_normals.h"

namespace sensor_rt {

/// Output arrays of closest_points, one entry per query point: closest surface point (3 values, row-major),
/// its face, and the distance, negative inside.
struct ClosestPoints {
  double* point = nullptr;  ///< may be null
  std::uint32_t* face = nullptr;
  double* signed_distance = nullptr;
};

/// A triangle mesh preprocessed for closest-point queries. The sign of distances is valid for closed meshes
/// with outward faces only.
class MeshSurface {
 public:
  /// Copies the mesh. Throws std::invalid_argument for an invalid mesh.
  explicit MeshSurface(const MeshView& mesh);

  /// Computes the closest points of `points` (count, 3), row-major, in the frame of the mesh. Double
  /// precision throughout; Embree only preselects the candidate faces. Throws std::invalid_argument for a
  /// point that is not finite.
  void closest_points(const double* points, std::size_t count, unsigned threads,
                      const ClosestPoints& result) const;

  /// Computes, for `triangles` (count, 3, 3), the distance of each triangle's centre from the mesh and an
  /// upper bound on the distance of all of its points: the smaller of the centre's plus the triangle's radius
  /// about it (a distance changes by no more than the way), and the largest distance of its corners from the
  /// face nearest to the centre (the distance from one face is a convex function). `is_signed`: negative
  /// inside.
  void triangle_distances(const double* triangles, std::size_t count, unsigned threads, bool is_signed,
                          double* centre, double* bound) const;

 private:
  /// Bounding box of a face relative to the mesh centre, rounded outwards.
  struct Box {
    float low[3];
    float high[3];

    double distance2(const Eigen::Vector3d& p) const;
  };
  struct Query;

  std::vector<double> vertices_;
  std::vector<std::uint32_t> faces_;
  MeshView mesh_;
  Eigen::Vector3d centre_;
  double reach_ = 0.0;  ///< largest absolute vertex coordinate relative to the centre
  std::vector<Box> boxes_;
  PseudoNormals normals_;
  SceneHandle scene_;
};

}  // namespace sensor_rt
