#include "sensor_rt/tracing/trace.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/tracing/lane_planes.h"
#include "sensor_rt/tracing/primitive.h"

namespace sensor_rt {
namespace {

/// Number of faces above which neighbouring rays no longer profit from coherent traversal, as measured.
constexpr std::size_t kVeryFine = 500'000;

SENSOR_RT_MULTIVERSION
void fill_rays(const Lanes3& origin, const Lanes3& direction, RTCRay16& ray) {
  for (int l = 0; l < kLanes; ++l) {
    ray.org_x[l] = static_cast<float>(origin.x[l]);
    ray.org_y[l] = static_cast<float>(origin.y[l]);
    ray.org_z[l] = static_cast<float>(origin.z[l]);
    ray.dir_x[l] = static_cast<float>(direction.x[l]);
    ray.dir_y[l] = static_cast<float>(direction.y[l]);
    ray.dir_z[l] = static_cast<float>(direction.z[l]);
    ray.tnear[l] = 0.0f;
    ray.time[l] = 0.0f;
    ray.mask[l] = ~0u;
    ray.id[l] = 0;
    ray.flags[l] = 0;
  }
}

/// Returns false when no active ray meets the bounding box of a shape before t = `farthest`.
SENSOR_RT_MULTIVERSION
bool meet_box(const Shape& shape, const Lanes3& __restrict origin, const Lanes3& __restrict direction,
              const int* __restrict valid, const double* __restrict farthest) {
  constexpr float kSlack = 1e-6f;  // far above the rounding of single precision
  const auto half_x = static_cast<float>(shape.half_size.x());
  const auto half_y = static_cast<float>(shape.half_size.y());
  const auto half_z = static_cast<float>(shape.half_size.z());
  const auto inverse = [](double d) {
    const auto single = static_cast<float>(d);
    return 1.0f / (single + std::copysign(1e-30f, single));
  };
  alignas(64) int meets[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    const auto x = static_cast<float>(origin.x[l]);
    const auto y = static_cast<float>(origin.y[l]);
    const auto z = static_cast<float>(origin.z[l]);
    const float in_x = inverse(direction.x[l]);
    const float in_y = inverse(direction.y[l]);
    const float in_z = inverse(direction.z[l]);
    const float to_x = std::copysign(half_x + kSlack * (1.0f + half_x + std::abs(x)), in_x);
    const float to_y = std::copysign(half_y + kSlack * (1.0f + half_y + std::abs(y)), in_y);
    const float to_z = std::copysign(half_z + kSlack * (1.0f + half_z + std::abs(z)), in_z);
    const float enter_x = (-to_x - x) * in_x;
    const float enter_y = (-to_y - y) * in_y;
    const float enter_z = (-to_z - z) * in_z;
    const float leave_x = (to_x - x) * in_x;
    const float leave_y = (to_y - y) * in_y;
    const float leave_z = (to_z - z) * in_z;
    const float enter_xy = enter_x > enter_y ? enter_x : enter_y;
    const float leave_xy = leave_x < leave_y ? leave_x : leave_y;
    const float enter = enter_xy > enter_z ? enter_xy : enter_z;
    const float leave = leave_xy < leave_z ? leave_xy : leave_z;
    const float last = static_cast<float>(farthest[l]) * (1.0f + kSlack);
    meets[l] = (enter <= leave) & (leave >= 0.0f) & (enter <= last) ? valid[l] : 0;
  }
  int any = 0;
  for (int l = 0; l < kLanes; ++l) any |= meets[l];
  return any != 0;
}

/// Largest way along a ray from a triangle to the exact surface of its face, m: beyond, the ray meets another
/// part of the surface, or none, and the triangle counts.
constexpr double kFarthestMove = 2e-3;
constexpr double kUncheckedMove = 2e-5;  // m: a longer way may lead past an edge of the face
constexpr double kNearFace = 2e-5;       // m between exact surfaces and their triangles, with a margin
constexpr double kGrazing = 1e-6;        // cosine below which a ray has no point of intersection
constexpr double kConverged = 1e-12;     // m
constexpr int kNewtonSteps = 12;
constexpr int kMostLayers = 8;  // of triangles that a ray passes without meeting their surface

/// Whether triangles of a face lie at a point of its exact surface; they end at the edges of the face.
bool is_on_face(const Shape& shape, const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
                std::int32_t number) {
  const Eigen::Vector3f from = (point + kNearFace * normal).cast<float>();
  const Eigen::Vector3f along = -normal.cast<float>();
  alignas(64) int valid[kLanes] = {-1};
  RTCRayHit16 rays = {};
  rays.ray.org_x[0] = from.x();
  rays.ray.org_y[0] = from.y();
  rays.ray.org_z[0] = from.z();
  rays.ray.dir_x[0] = along.x();
  rays.ray.dir_y[0] = along.y();
  rays.ray.dir_z[0] = along.z();
  rays.ray.tfar[0] = static_cast<float>(2.0 * kNearFace);
  rays.ray.mask[0] = ~0u;
  rays.hit.geomID[0] = RTC_INVALID_GEOMETRY_ID;
  intersect16(shape.embree.get(), valid, rays);
  return rays.hit.geomID[0] != RTC_INVALID_GEOMETRY_ID && shape.curved_of_face[rays.hit.primID[0]] == number;
}

/// Moves hits from the triangles to the exact surfaces of their faces, by Newton's method along the rays,
/// which begin before them: the triangles enclose convex surfaces. `coarse`: where the rays meet the
/// triangles. Sets again[lane] to -1 and found.t to kNoHit where the ray passes between a triangle and its
/// surface, else to 0, and returns whether there is such a lane.
bool meet_exact_faces(const Shape& shape, const Lanes3& origin, const Lanes3& direction, const float* coarse,
                      Candidates& found, int* again) {
  bool any = false;
  for (int l = 0; l < kLanes; ++l) {
    again[l] = 0;
    const std::int32_t number = shape.curved_of_face[found.face[l]];
    if (number < 0 || !(found.t[l] < kNoHit)) continue;
    const CurvedFace& face = shape.curved[static_cast<std::size_t>(number)];
    const Eigen::Vector3d from = lane(origin, l);
    const Eigen::Vector3d along = lane(direction, l);
    const double length = along.norm();
    const double start = coarse[l];
    double t = start;
    Eigen::Vector3d gradient;
    double distance = face.distance(from + t * along, gradient);
    for (int step = 0; step < kNewtonSteps && std::abs(distance) > kConverged; ++step) {
      const double towards = gradient.dot(along);
      if (!(std::abs(towards) > kGrazing * length)) break;
      t -= distance / towards;
      if (!(std::abs(t - start) * length <= kFarthestMove)) break;
      distance = face.distance(from + t * along, gradient);
    }
    const double move = std::abs(t - start) * length;
    bool meets = std::abs(distance) <= kConverged && t > 0.0 && move <= kFarthestMove;
    const Eigen::Vector3d outward = lane(found.normal, l);
    const double side = gradient.dot(outward) < 0.0 ? -1.0 : 1.0;
    if (meets && move > kUncheckedMove && !is_on_face(shape, from + t * along, gradient, number)) {
      // Beyond an edge of the face the triangle counts, but not before the other side of the surface.
      if (side * gradient.dot(along) * outward.dot(along) > 0.0) continue;
      meets = false;
    }
    if (!meets) {
      found.t[l] = kNoHit;
      again[l] = -1;
      any = true;
      continue;
    }
    found.t[l] = t;
    found.normal.x[l] = side * gradient.x();
    found.normal.y[l] = side * gradient.y();
    found.normal.z[l] = side * gradient.z();
  }
  return any;
}

/// Finds the nearest triangles up to the ends of the rays; returns false when no ray meets one.
bool find_triangles(const Shape& shape, const Lanes3& origin, const Lanes3& direction, const int* valid,
                    RTCRayHit16& rays, Candidates& found) {
  for (std::uint32_t& id : rays.hit.geomID) id = RTC_INVALID_GEOMETRY_ID;
  intersect16(shape.embree.get(), valid, rays);
  bool any = false;
  for (int l = 0; l < kLanes; ++l) {
    const bool hit = valid[l] != 0 && rays.hit.geomID[l] != RTC_INVALID_GEOMETRY_ID;
    any = any || hit;
    found.face[l] = hit ? rays.hit.primID[l] : 0;
  }
  if (!any) return false;
  LanePlanes planes;
  look_up(shape.planes, found, planes);
  intersect_planes(planes, origin, direction, rays.ray.tfar, found.t);
  for (int l = 0; l < kLanes; ++l) {
    if (valid[l] == 0 || rays.hit.geomID[l] == RTC_INVALID_GEOMETRY_ID) found.t[l] = kNoHit;
  }
  return true;
}

/// Finds the nearest faces up to t = farthest[lane]; returns false when no ray hits the mesh.
bool find_faces(const Shape& shape, const Lanes3& origin, const Lanes3& direction, const int* valid,
                const double* farthest, Candidates& found) {
  RTCRayHit16 rays;
  fill_rays(origin, direction, rays.ray);
  // Rounded up, so that a surface at the current closest distance is not lost before the comparison in double
  // precision.
  const auto end = [&](int l) { return static_cast<float>(farthest[l]) * 1.00001f; };
  for (int l = 0; l < kLanes; ++l) rays.ray.tfar[l] = end(l);
  if (!find_triangles(shape, origin, direction, valid, rays, found)) return false;
  if (shape.curved_of_face.empty()) return true;
  alignas(64) int again[kLanes];
  bool any = meet_exact_faces(shape, origin, direction, rays.ray.tfar, found, again);
  for (int layer = 0; any && layer < kMostLayers; ++layer) {
    for (int l = 0; l < kLanes; ++l) {
      if (again[l] == 0) continue;
      rays.ray.tnear[l] = std::nextafter(rays.ray.tfar[l], std::numeric_limits<float>::infinity());
      rays.ray.tfar[l] = end(l);
    }
    Candidates behind;
    if (!find_triangles(shape, origin, direction, again, rays, behind)) break;
    alignas(64) int passed[kLanes];
    any = meet_exact_faces(shape, origin, direction, rays.ray.tfar, behind, passed);
    for (int l = 0; l < kLanes; ++l) {
      if (again[l] == 0) continue;
      found.t[l] = behind.t[l];
      found.face[l] = behind.face[l];
      found.normal.x[l] = behind.normal.x[l];
      found.normal.y[l] = behind.normal.y[l];
      found.normal.z[l] = behind.normal.z[l];
      again[l] = passed[l];
    }
  }
  return true;
}

void take_nearer(std::int32_t index, const LaneTransform& transform, const Candidates& found,
                 PacketHits& hits) {
  alignas(64) double nearer[kLanes];
  keep_nearer(transform.rotation, found, hits, nearer);
  for (int l = 0; l < kLanes; ++l) {
    hits.shape[l] = nearer[l] > 0.0 ? index : hits.shape[l];
    hits.face[l] = nearer[l] > 0.0 ? found.face[l] : hits.face[l];
  }
}

}  // namespace

void clear_hits(PacketHits& hits, double farthest) {
  for (int l = 0; l < kLanes; ++l) {
    hits.t[l] = farthest;
    hits.normal.x[l] = hits.normal.y[l] = hits.normal.z[l] = 0.0;
    hits.shape[l] = -1;
    hits.face[l] = 0;
  }
}

void intersect_shape(const Shape& shape, std::int32_t index, const LaneTransform& transform,
                     const Lanes3& direction, const int* valid, PacketHits& hits) {
  Lanes3 local;
  to_shape_frame(transform.rotation, direction, local);
  if (!meet_box(shape, transform.origin, local, valid, hits.t)) return;
  Candidates found;
  if (shape.kind == ShapeKind::kMesh) {
    if (!find_faces(shape, transform.origin, local, valid, hits.t, found)) return;
  } else {
    intersect_primitive(shape, transform.origin, local, found.t, found.normal);
    for (int l = 0; l < kLanes; ++l) {
      if (valid[l] == 0) found.t[l] = kNoHit;
      found.face[l] = 0;
    }
  }
  take_nearer(index, transform, found, hits);
}

void occlude_by_shape(const Shape& shape, const LaneTransform& transform, const Lanes3& direction,
                      double farthest, int* unoccluded) {
  Lanes3 local;
  to_shape_frame(transform.rotation, direction, local);
  alignas(64) double end[kLanes];
  std::fill(end, end + kLanes, farthest);
  if (!meet_box(shape, transform.origin, local, unoccluded, end)) return;
  if (!shape.curved_of_face.empty()) {
    // The triangles enclose the surfaces, from which segments start or at which they end.
    alignas(64) int valid[kLanes];
    std::copy(unoccluded, unoccluded + kLanes, valid);
    Candidates found;
    if (!find_faces(shape, transform.origin, local, valid, end, found)) return;
    for (int l = 0; l < kLanes; ++l) unoccluded[l] = found.t[l] < farthest ? 0 : unoccluded[l];
  } else if (shape.kind == ShapeKind::kMesh) {
    RTCRay16 rays;
    fill_rays(transform.origin, local, rays);
    for (float& tfar : rays.tfar) tfar = static_cast<float>(farthest);
    alignas(64) int valid[kLanes];
    for (int l = 0; l < kLanes; ++l) valid[l] = unoccluded[l];
    occluded16(shape.embree.get(), valid, shape.planes.size() < kVeryFine, rays);
    for (int l = 0; l < kLanes; ++l) unoccluded[l] = rays.tfar[l] < 0.0f ? 0 : unoccluded[l];
  } else {
    alignas(64) double t[kLanes];
    Lanes3 normal;
    intersect_primitive(shape, transform.origin, local, t, normal);
    for (int l = 0; l < kLanes; ++l) unoccluded[l] = t[l] < farthest ? 0 : unoccluded[l];
  }
}

}  // namespace sensor_rt
