#include "sensor_rt/scene/trace.h"

#include <cmath>
#include <limits>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/scene/primitive.h"

namespace sensor_rt {
namespace {

/// A plane met in double precision may differ from Embree's hit by so much (metres): rounding at grazing
/// incidence. Beyond that the ray runs along the plane and Embree's hit is the better one.
constexpr double kLargestCorrection = 1e-4;

SENSOR_RT_MULTIVERSION
void to_shape_frame(const double (*r)[kLanes], const Lanes3& d, Lanes3& out) {
  for (int l = 0; l < kLanes; ++l) {
    out.x[l] = r[0][l] * d.x[l] + r[1][l] * d.y[l] + r[2][l] * d.z[l];
    out.y[l] = r[3][l] * d.x[l] + r[4][l] * d.y[l] + r[5][l] * d.z[l];
    out.z[l] = r[6][l] * d.x[l] + r[7][l] * d.y[l] + r[8][l] * d.z[l];
  }
}

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

struct alignas(64) LanePlanes {
  double normal_x[kLanes];
  double normal_y[kLanes];
  double normal_z[kLanes];
  double offset[kLanes];
};

/// Meets the planes of the faces that were hit again, in double precision.
SENSOR_RT_MULTIVERSION
void meet_planes(const LanePlanes& p, const Lanes3& o, const Lanes3& d, const float* coarse, double* t) {
  for (int l = 0; l < kLanes; ++l) {
    const double towards = p.normal_x[l] * d.x[l] + p.normal_y[l] * d.y[l] + p.normal_z[l] * d.z[l];
    const double away = p.normal_x[l] * o.x[l] + p.normal_y[l] * o.y[l] + p.normal_z[l] * o.z[l];
    const double fine = (p.offset[l] - away) / (towards == 0.0 ? 1e-300 : towards);
    const double length2 = d.x[l] * d.x[l] + d.y[l] * d.y[l] + d.z[l] * d.z[l];
    const double change = fine - static_cast<double>(coarse[l]);
    const bool credible = change * change * length2 <= kLargestCorrection * kLargestCorrection && fine > 0.0;
    t[l] = credible ? fine : static_cast<double>(coarse[l]);
  }
}

SENSOR_RT_MULTIVERSION
void keep_nearer(const double (*r)[kLanes], const double* t, const Lanes3& n, const std::int32_t* shape,
                 const std::uint32_t* face, PacketHits& hits) {
  for (int l = 0; l < kLanes; ++l) {
    const bool nearer = shape[l] >= 0 && t[l] < hits.t[l];
    const double x = r[0][l] * n.x[l] + r[3][l] * n.y[l] + r[6][l] * n.z[l];
    const double y = r[1][l] * n.x[l] + r[4][l] * n.y[l] + r[7][l] * n.z[l];
    const double z = r[2][l] * n.x[l] + r[5][l] * n.y[l] + r[8][l] * n.z[l];
    hits.t[l] = nearer ? t[l] : hits.t[l];
    hits.normal.x[l] = nearer ? x : hits.normal.x[l];
    hits.normal.y[l] = nearer ? y : hits.normal.y[l];
    hits.normal.z[l] = nearer ? z : hits.normal.z[l];
    hits.shape[l] = nearer ? shape[l] : hits.shape[l];
    hits.face[l] = nearer ? face[l] : hits.face[l];
  }
}

struct Candidates {
  alignas(64) double t[kLanes];
  Lanes3 normal;
  alignas(64) std::int32_t shape[kLanes];
  alignas(64) std::uint32_t face[kLanes];
};

bool find_faces(const Shape& shape, std::int32_t index, const Lanes3& origin, const Lanes3& direction,
                const int* valid, const PacketHits& hits, Candidates& found) {
  RTCRayHit16 rays;
  fill_rays(origin, direction, rays.ray);
  for (int l = 0; l < kLanes; ++l) {
    // Rounded up, so that a surface in the distance found so far is not lost before the comparison in double.
    rays.ray.tfar[l] = static_cast<float>(hits.t[l]) * 1.00001f;
    rays.hit.geomID[l] = RTC_INVALID_GEOMETRY_ID;
  }
  intersect16(shape.embree.get(), valid, rays);
  LanePlanes planes;
  bool any = false;
  for (int l = 0; l < kLanes; ++l) {
    const bool hit = valid[l] != 0 && rays.hit.geomID[l] != RTC_INVALID_GEOMETRY_ID;
    any = any || hit;
    found.face[l] = hit ? rays.hit.primID[l] : 0;
    found.shape[l] = hit ? index : -1;
    const FacePlane& plane = shape.planes[found.face[l]];
    planes.normal_x[l] = plane.normal[0];
    planes.normal_y[l] = plane.normal[1];
    planes.normal_z[l] = plane.normal[2];
    planes.offset[l] = plane.offset;
    found.normal.x[l] = plane.normal[0];
    found.normal.y[l] = plane.normal[1];
    found.normal.z[l] = plane.normal[2];
  }
  if (any) meet_planes(planes, origin, direction, rays.ray.tfar, found.t);
  return any;
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
  Candidates found;
  if (shape.kind == ShapeKind::kMesh) {
    if (!find_faces(shape, index, transform.origin, local, valid, hits, found)) return;
  } else {
    intersect_primitive(shape, transform.origin, local, found.t, found.normal);
    for (int l = 0; l < kLanes; ++l) {
      found.shape[l] = valid[l] != 0 && found.t[l] < std::numeric_limits<double>::infinity() ? index : -1;
      found.face[l] = 0;
    }
  }
  keep_nearer(transform.rotation, found.t, found.normal, found.shape, found.face, hits);
}

void occlude_by_shape(const Shape& shape, const LaneTransform& transform, const Lanes3& direction,
                      double farthest, int* open) {
  Lanes3 local;
  to_shape_frame(transform.rotation, direction, local);
  if (shape.kind == ShapeKind::kMesh) {
    RTCRay16 rays;
    fill_rays(transform.origin, local, rays);
    for (float& tfar : rays.tfar) tfar = static_cast<float>(farthest);
    alignas(64) int valid[kLanes];
    for (int l = 0; l < kLanes; ++l) valid[l] = open[l];
    occluded16(shape.embree.get(), valid, rays);
    for (int l = 0; l < kLanes; ++l) open[l] = rays.tfar[l] < 0.0f ? 0 : open[l];
  } else {
    alignas(64) double t[kLanes];
    Lanes3 normal;
    intersect_primitive(shape, transform.origin, local, t, normal);
    for (int l = 0; l < kLanes; ++l) open[l] = t[l] < farthest ? 0 : open[l];
  }
}

}  // namespace sensor_rt
