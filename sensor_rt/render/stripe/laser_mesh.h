// Surface that the laser lights, as a mesh between laser rays, and its images.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/render/stripe/stripe_samples.h"
#include "sensor_rt/tracing/ray_view.h"
#include "sensor_rt/tracing/scene_query.h"

namespace sensor_rt {

/// Lit surface at one instant, seen from one point of the laser source.
///
/// A grid of laser rays samples the sheet along the fan and through its thickness. Four neighbouring rays
/// whose hits lie on each other's tangent planes, and of which each camera sees all or none, bound a
/// quadrilateral. Elsewhere the grid is bisected until an edge or the border of a shadow is located to a
/// small fraction of a pixel. Only closest hits count, so that steps, occlusions and several stripes per
/// column need no special cases. A feature thinner than the ray spacing may be missed.
///
/// Light that leaves a translucent surface beside the sheet has a wider mesh for each Gaussian of its
/// distribution. It is taken from the point in the middle of the sheet at the same fan angle, if the surface
/// is about flat between both.
class LaserMesh {
 public:
  enum class State : std::uint8_t { kHidden, kSeen, kOutside };

  /// A vertex in a camera.
  struct Image {
    double column = 0.0;
    double row = 0.0;
    /// Electrons per second that a pixel full of its brightness would receive at the centre of the sheet.
    double light = 0.0;
    /// Distance from the centre of the sheet, standard deviations of the profile that motion widens.
    double across = 0.0;
    State state = State::kHidden;
  };

  /// First hit of a laser ray.
  struct Vertex {
    Eigen::Vector3d point = Eigen::Vector3d::Zero();  ///< reference frame
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    double across = 0.0;        ///< distance from the centre of the sheet, standard deviations
    std::int32_t shape = -1;    ///< -1: no hit
    bool is_entry_near = true;  ///< whether `entry` is on the same, about flat surface
    Eigen::Vector3d entry = Eigen::Vector3d::Zero();  ///< where light that leaves here has entered
  };

  /// Corners in cyclic order: from 0 to 1 and from 3 to 2 along the fan, from 0 to 3 and from 1 to 2 across
  /// it.
  struct Quad {
    std::array<std::uint32_t, 4> corner{};
    int along = 0;  ///< number of bisections
    int across = 0;
    bool splits_along = false;  ///< direction of the next bisection
  };

  /// All must outlive the use of the mesh.
  void set(const RenderPlan& plan, const Scene& scene, const StripeSamples& samples);

  /// Part of the light that is reflected at the surface, among the parts of Subsurface.
  static constexpr int kAtSurface = -1;

  /// Builds the mesh of a sample for a part of the light. Needs a shape that `has_subsurface` for those of
  /// Subsurface.
  void build(std::size_t sample, int part = kAtSurface);

  /// Returns whether the laser may reach a translucent surface.
  bool has_subsurface() const;

  const std::vector<Quad>& quads() const { return quads_; }
  const Vertex& vertex(std::uint32_t number) const { return vertices_[number]; }
  const Image& image(std::size_t camera, std::uint32_t number) const { return images_[camera][number]; }
  /// Returns whether an image column may show an edge.
  bool has_edge(std::size_t camera, int column) const {
    return edges_[camera][static_cast<std::size_t>(column)] != 0;
  }
  bool is_empty() const { return laser_.empty(); }

 private:
  /// A laser ray: unit vector (y, z) in the fan, and slope (x per distance) from the centre of the sheet.
  struct Beam {
    double y, z, slope;
  };
  /// kBorder: seen by some cameras only in part; kEdge: of several surfaces.
  enum class Fit { kDark, kWhole, kBorder, kEdge, kSplitAlong, kSplitAcross };

  static Beam middle(const Beam& a, const Beam& b);
  void cast(std::size_t first);
  void cast_packet(std::size_t first, int count);
  void find_entries(std::size_t first, int count);
  void view_packet(std::size_t camera, std::size_t first, int count, const Lanes3& points);
  void illuminate(std::size_t camera, const Vertex& vertex, Image& image) const;
  void spread_below(const Subsurface& medium, const Vertex& vertex, const Eigen::Vector3d& to_source,
                    const Eigen::Vector3d& to_viewpoint, Image& image, double& variance) const;
  void consider(const Quad& quad);
  void refine();
  Fit fit(const Quad& quad) const;
  bool are_continuous(std::uint32_t a, std::uint32_t b) const;
  bool may_see(std::size_t camera, const Quad& quad) const;
  void mark_edge(const Quad& quad);
  bool is_uneven(const Quad& quad) const;

  const RenderPlan* plan_ = nullptr;
  const Scene* scene_ = nullptr;
  RayView laser_;
  std::vector<RayView> cameras_;
  std::size_t sample_ = 0;
  int part_ = kAtSurface;
  double reach_ = 0.0;    ///< of the part on the surface, m; 0: at the surface
  double largest_ = 0.0;  ///< px: size of a quadrilateral that is linear in the image
  std::size_t lattice_point_ = 0;
  const StripeSamples* samples_ = nullptr;
  std::vector<Beam> beams_;  ///< per vertex
  std::vector<Vertex> vertices_;
  std::vector<std::vector<Image>> images_;        ///< per camera, per vertex
  std::vector<std::vector<std::uint8_t>> edges_;  ///< per camera, per column
  std::vector<Quad> quads_;
  std::vector<Quad> open_;  ///< to be bisected
  std::vector<Quad> bisected_;
};

}  // namespace sensor_rt
