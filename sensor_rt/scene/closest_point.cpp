#include "sensor_rt/scene/closest_point.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "sensor_rt/geometry/parallel.h"

namespace sensor_rt {
namespace {

struct TrianglePoint {
  Eigen::Vector3d point;
  int feature = kTriangleInside;
};

/// Returns the closest point of a triangle by its Voronoi regions (C. Ericson, "Real-Time Collision
/// Detection", 2005, 5.1.5).
TrianglePoint closest_on_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a,
                                  const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
  const Eigen::Vector3d ab = b - a;
  const Eigen::Vector3d ac = c - a;
  const double d1 = ab.dot(p - a);
  const double d2 = ac.dot(p - a);
  if (d1 <= 0.0 && d2 <= 0.0) return {a, 0};
  const double d3 = ab.dot(p - b);
  const double d4 = ac.dot(p - b);
  if (d3 >= 0.0 && d4 <= d3) return {b, 1};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 > d3) return {a + (d1 / (d1 - d3)) * ab, 3};
  const double d5 = ab.dot(p - c);
  const double d6 = ac.dot(p - c);
  if (d6 >= 0.0 && d5 <= d6) return {c, 2};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 > d6) return {a + (d2 / (d2 - d6)) * ac, 5};
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0.0 && d4 >= d3 && d5 >= d6 && (d4 > d3 || d5 > d6))
    return {b + ((d4 - d3) / ((d4 - d3) + (d5 - d6))) * (c - b), 4};
  const double scale = 1.0 / (va + vb + vc);
  return {a + (vb * scale) * ab + (vc * scale) * ac, kTriangleInside};
}

/// Returns the search radius in single precision, rounded up so that no closer face is missed.
float search_radius(double distance, double slack) {
  return static_cast<float>((distance + slack) * (1.0 + 1e-6));
}

const MeshView& validated(const MeshView& mesh) {
  validate_mesh(mesh, "mesh");
  return mesh;
}

}  // namespace

struct MeshSurface::Query {
  const MeshSurface& surface;
  Eigen::Vector3d point;
  Eigen::Vector3d from_centre;
  double slack;  ///< tolerance for rounding to single precision, m
  double distance2 = std::numeric_limits<double>::infinity();
  TrianglePoint best = {};
  std::uint32_t face = 0;

  Query(const MeshSurface& mesh_surface, const Eigen::Vector3d& p)
      : surface(mesh_surface),
        point(p),
        from_centre(p - mesh_surface.centre_),
        slack(4.0 * 6e-8 * (mesh_surface.reach_ + from_centre.cwiseAbs().maxCoeff())) {}

  float radius() const { return search_radius(std::sqrt(distance2), slack); }

  /// Updates the closest face; returns whether it changed.
  bool try_face(std::uint32_t number) {
    if (surface.boxes_[number].distance2(from_centre) > distance2) return false;
    const MeshView& mesh = surface.mesh_;
    const TrianglePoint candidate =
        closest_on_triangle(point, mesh.corner(number, 0), mesh.corner(number, 1), mesh.corner(number, 2));
    const double candidate2 = (candidate.point - point).squaredNorm();
    // The lower face index wins a tie, so that the order of the traversal does not matter.
    if (!(candidate2 < distance2 || (candidate2 == distance2 && number < face))) return false;
    distance2 = candidate2;
    best = candidate;
    face = number;
    return true;
  }

  static bool visit(RTCPointQueryFunctionArguments* arguments) {
    Query& query = *static_cast<Query*>(arguments->userPtr);
    if (!query.try_face(arguments->primID)) return false;
    const float radius = query.radius();
    if (!(radius < arguments->query->radius)) return false;
    arguments->query->radius = radius;
    return true;
  }

  void search() {
    const Eigen::Vector3f local = from_centre.cast<float>();
    RTCPointQuery embree_query{};
    embree_query.x = local.x();
    embree_query.y = local.y();
    embree_query.z = local.z();
    embree_query.time = 0.0f;
    embree_query.radius = radius();
    RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    rtcPointQuery(surface.scene_.get(), &embree_query, &context, &visit, this);
  }
};

double MeshSurface::Box::distance2(const Eigen::Vector3d& p) const {
  double sum = 0.0;
  for (int k = 0; k < 3; ++k) {
    const double gap = std::max(0.0, std::max(double{low[k]} - p[k], p[k] - double{high[k]}));
    sum += gap * gap;
  }
  return sum;
}

MeshSurface::MeshSurface(const MeshView& mesh)
    : vertices_(validated(mesh).vertices, mesh.vertices + 3 * mesh.vertex_count),
      faces_(mesh.faces, mesh.faces + 3 * mesh.face_count),
      mesh_{vertices_.data(), mesh.vertex_count, faces_.data(), mesh.face_count},
      centre_(mesh_centre(mesh_)),
      boxes_(mesh.face_count),
      normals_(mesh_),
      scene_(build_triangle_scene(mesh_, centre_)) {
  constexpr float kFar = std::numeric_limits<float>::infinity();
  for (std::size_t face = 0; face < mesh.face_count; ++face) {
    for (int k = 0; k < 3; ++k) {
      double low = mesh_.corner(face, 0)[k] - centre_[k];
      double high = low;
      for (int c = 1; c < 3; ++c) {
        low = std::min(low, mesh_.corner(face, c)[k] - centre_[k]);
        high = std::max(high, mesh_.corner(face, c)[k] - centre_[k]);
      }
      boxes_[face].low[k] = std::nextafter(static_cast<float>(low), -kFar);
      boxes_[face].high[k] = std::nextafter(static_cast<float>(high), kFar);
      reach_ = std::max(reach_, std::max(-low, high));
    }
  }
}

void MeshSurface::closest_points(const double* points, std::size_t count, unsigned threads,
                                 const ClosestPoints& result) const {
  for (std::size_t i = 0; i < 3 * count; ++i) {
    if (!std::isfinite(points[i]) || std::abs(points[i]) > 1e6) {
      throw std::invalid_argument("point " + std::to_string(i / 3) + " is not finite or beyond 1000 km");
    }
  }
  constexpr std::size_t kBlock = 1024;
  parallel_for((count + kBlock - 1) / kBlock, threads, [&](std::size_t block, unsigned) {
    const std::size_t first = block * kBlock;
    for (std::size_t i = first; i < std::min(count, first + kBlock); ++i) {
      Query query(*this, Eigen::Map<const Eigen::Vector3d>(points + 3 * i));
      // Warm start: consecutive scan points mostly have the same closest face.
      if (i > first) query.try_face(result.face[i - 1]);
      query.search();
      const Eigen::Vector3d offset = query.point - query.best.point;
      const bool inside = offset.dot(normals_.at(query.face, query.best.feature)) < 0.0;
      if (result.point != nullptr) Eigen::Map<Eigen::Vector3d>(result.point + 3 * i) = query.best.point;
      result.face[i] = query.face;
      result.signed_distance[i] = std::copysign(std::sqrt(query.distance2), inside ? -1.0 : 1.0);
    }
  });
}

void MeshSurface::triangle_distances(const double* triangles, std::size_t count, unsigned threads,
                                     bool is_signed, double* centre, double* bound) const {
  using Triangle = Eigen::Map<const Eigen::Matrix3d>;  // corners in its columns
  std::vector<double> centres(3 * count);
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector3d middle = Triangle(triangles + 9 * i).rowwise().mean();
    std::copy_n(middle.data(), 3, &centres[3 * i]);
  }
  std::vector<std::uint32_t> nearest(count);
  closest_points(centres.data(), count, threads, {nullptr, nearest.data(), centre});
  for (std::size_t i = 0; i < count; ++i) {
    const Triangle corners(triangles + 9 * i);
    const Eigen::Map<const Eigen::Vector3d> middle(&centres[3 * i]);
    const std::size_t face = nearest[i];
    double radius2 = 0.0;
    double from_face2 = 0.0;
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d corner = corners.col(k);
      const Eigen::Vector3d on_face =
          closest_on_triangle(corner, mesh_.corner(face, 0), mesh_.corner(face, 1), mesh_.corner(face, 2))
              .point;
      radius2 = std::max(radius2, (corner - middle).squaredNorm());
      from_face2 = std::max(from_face2, (corner - on_face).squaredNorm());
    }
    if (!is_signed) centre[i] = std::abs(centre[i]);
    bound[i] = std::min(centre[i] + std::sqrt(radius2), std::sqrt(from_face2));
  }
}

}  // namespace sensor_rt
