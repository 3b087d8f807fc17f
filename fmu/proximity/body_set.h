// Rigid bodies with triangle meshes at their present poses: what lies on a ray, and what reaches into a box.
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
  double distance = 0;  // m from the ray's origin
};

/// Which bodies a question is about: one flag for each.
using Selection = std::vector<bool>;

class BodySet {
 public:
  explicit BodySet(const std::vector<TriangleMesh>& meshes);
  ~BodySet();
  BodySet(BodySet&&) noexcept;

  std::size_t size() const;

  void place(std::size_t body, const Eigen::Isometry3d& world_from_body);

  /// Nearest surface of the selected bodies on a ray (world, unit direction) between two distances.
  std::optional<RayHit> cast(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction, double nearest,
                             double farthest, const Selection& selection) const;

  /// Whether a body reaches into a box, or a closed one surrounds it; `size` holds the box's edges.
  bool reaches_into(std::size_t body, const Eigen::Isometry3d& world_from_box,
                    const Eigen::Vector3d& size) const;

  struct Body;
  const Body& body(std::size_t number) const;

 private:
  std::vector<Body> bodies_;
};

}  // namespace robotcell::proximity
