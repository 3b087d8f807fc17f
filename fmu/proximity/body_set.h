// Rigid bodies with triangle meshes at their present poses: ray casting and box overlap.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <memory>
#include <optional>
#include <vector>

namespace robotcell::proximity {

struct TriangleMesh {
  std::vector<Eigen::Vector3d> vertices;  // body frame, m
  std::vector<std::array<int, 3>> faces;
};

struct RayHit {
  std::size_t body = 0;
  double distance = 0;  // m, from the ray origin
};

/// Selected bodies: one flag for each.
using Selection = std::vector<bool>;

class BodySet {
 public:
  /// Bounding volumes of meshes that are equal to one of `known` are shared with it.
  explicit BodySet(std::vector<TriangleMesh> meshes, const BodySet* known = nullptr);
  ~BodySet();
  BodySet(const BodySet&);
  BodySet(BodySet&&) noexcept;

  std::size_t size() const;

  void set_pose(std::size_t body, const Eigen::Isometry3d& world_from_body);

  /// Nearest surface of the selected bodies along a ray (world, unit direction) between two distances.
  std::optional<RayHit> cast_ray(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                                 double nearest, double farthest, const Selection& selection) const;

  /// Whether a body intersects a box or a closed body encloses it; `size` holds the edge lengths of the box.
  bool intersects_box(std::size_t body, const Eigen::Isometry3d& world_from_box,
                      const Eigen::Vector3d& size) const;

  struct Body;
  const Body& body(std::size_t number) const;

 private:
  std::vector<Body> bodies_;
};

}  // namespace robotcell::proximity
