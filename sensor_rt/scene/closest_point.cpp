#include "sensor_rt/scene/closest_point.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "sensor_rt/geometry/parallel.h"
#include "sensor_rt/scene/pseudo_normals.h"

namespace sensor_rt {
namespace {

struct TrianglePoint {
  Eigen::Vector3d point;
  int feature = kTriangleInside;
};

/// Closest point of a triangle by its Voronoi regions (C. Ericson, "Real-Time Collision Detection",
/// 2005, 5.1.5).
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

struct Query {
  const MeshView* mesh;
  Eigen::Vector3d point;
  double slack;  ///< what rounding to single precision may hide, m
  double distance2 = std::numeric_limits<double>::infinity();
  TrianglePoint best;
  std::uint32_t face = 0;
};

/// Radius in single precision within which nothing nearer can be missed.
float search_radius(double distance, double slack) {
  return static_cast<float>((distance + slack) * (1.0 + 1e-6));
}

bool visit_triangle(RTCPointQueryFunctionArguments* arguments) {
  Query& query = *static_cast<Query*>(arguments->userPtr);
  const std::uint32_t face = arguments->primID;
  const TrianglePoint candidate = closest_on_triangle(
      query.point, query.mesh->corner(face, 0), query.mesh->corner(face, 1), query.mesh->corner(face, 2));
  const double distance2 = (candidate.point - query.point).squaredNorm();
  // Ties go to the lower number, so that the order of the visit does not matter.
  if (!(distance2 < query.distance2 || (distance2 == query.distance2 && face < query.face))) return false;
  query.distance2 = distance2;
  query.best = candidate;
  query.face = face;
  const float radius = search_radius(std::sqrt(distance2), query.slack);
  if (!(radius < arguments->query->radius)) return false;
  arguments->query->radius = radius;
  return true;
}

void search(RTCScene scene, const Eigen::Vector3d& centre, Query& query) {
  const Eigen::Vector3f local = (query.point - centre).cast<float>();
  RTCPointQuery embree_query{};
  embree_query.x = local.x();
  embree_query.y = local.y();
  embree_query.z = local.z();
  embree_query.time = 0.0f;
  embree_query.radius = std::numeric_limits<float>::infinity();
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  rtcPointQuery(scene, &embree_query, &context, &visit_triangle, &query);
}

}  // namespace

ClosestPoints closest_points(const MeshView& mesh, const double* points, std::size_t count,
                             unsigned threads) {
  validate_mesh(mesh, "mesh");
  for (std::size_t i = 0; i < 3 * count; ++i) {
    if (!std::isfinite(points[i]) || std::abs(points[i]) > 1e6) {
      throw std::invalid_argument("point " + std::to_string(i / 3) + " is not finite or beyond 1000 km");
    }
  }
  const Eigen::Vector3d centre = mesh_centre(mesh);
  const SceneHandle scene = build_triangle_scene(mesh, centre);
  const PseudoNormals normals(mesh);
  double reach = 0.0;
  for (std::size_t i = 0; i < mesh.vertex_count; ++i) {
    reach = std::max(reach, (mesh.vertex(i) - centre).cwiseAbs().maxCoeff());
  }
  ClosestPoints result;
  result.point.resize(count);
  result.face.resize(count);
  result.signed_distance.resize(count);
  constexpr std::size_t kBlock = 1024;
  parallel_for((count + kBlock - 1) / kBlock, threads, [&](std::size_t block, unsigned) {
    const std::size_t end = std::min(count, (block + 1) * kBlock);
    for (std::size_t i = block * kBlock; i < end; ++i) {
      Query query;
      query.mesh = &mesh;
      query.point = Eigen::Map<const Eigen::Vector3d>(points + 3 * i);
      query.slack = 4.0 * 6e-8 * (reach + (query.point - centre).cwiseAbs().maxCoeff());
      search(scene.get(), centre, query);
      const Eigen::Vector3d offset = query.point - query.best.point;
      const bool inside = offset.dot(normals.at(query.face, query.best.feature)) < 0.0;
      result.point[i] = query.best.point;
      result.face[i] = query.face;
      result.signed_distance[i] = std::copysign(std::sqrt(query.distance2), inside ? -1.0 : 1.0);
    }
  });
  return result;
}

}  // namespace sensor_rt
