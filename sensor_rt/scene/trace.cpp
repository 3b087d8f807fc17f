#include "sensor_rt/scene/trace.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/scene/primitive.h"

namespace sensor_rt {
namespace {

/// A plane met in double precision may differ from Embree's hit by so much (metres): rounding at grazing
/// incidence. Beyond that the ray runs along the plane and Embree's hit is the better one.
constexpr double kLargestCorrection = 1e-4;

constexpr double kNone = std::numeric_limits<double>::infinity();

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
void meet_planes(const LanePlanes& __restrict p, const Lanes3& __restrict o, const Lanes3& __restrict d,
                 const float* __restrict coarse, double* __restrict t) {
  for (int l = 0; l < kLanes; ++l) {
    const double towards = p.normal_x[l] * d.x[l] + p.normal_y[l] * d.y[l] + p.normal_z[l] * d.z[l];
    const double away = p.normal_x[l] * o.x[l] + p.normal_y[l] * o.y[l] + p.normal_z[l] * o.z[l];
    const double fine = (p.offset[l] - away) / (towards == 0.0 ? 1e-300 : towards);
    const double length2 = d.x[l] * d.x[l] + d.y[l] * d.y[l] + d.z[l] * d.z[l];
    const double change = fine - static_cast<double>(coarse[l]);
    const double rough = static_cast<double>(coarse[l]);
    const bool credible =
        (change * change * length2 <= kLargestCorrection * kLargestCorrection) & (fine > 0.0);
    t[l] = credible ? fine : rough;
  }
}

/// Candidate hits of one shape; t is infinite where there is none.
struct Candidates {
  alignas(64) double t[kLanes];
  Lanes3 normal;
  alignas(64) std::uint32_t face[kLanes];
};

/// Where rays meet their planes, infinite behind their origin.
SENSOR_RT_MULTIVERSION
void meet_planes_ahead(const LanePlanes& __restrict p, const Lanes3& __restrict o, const Lanes3& __restrict d,
                       double* __restrict t) {
  for (int l = 0; l < kLanes; ++l) {
    const double towards = p.normal_x[l] * d.x[l] + p.normal_y[l] * d.y[l] + p.normal_z[l] * d.z[l];
    const double away = p.normal_x[l] * o.x[l] + p.normal_y[l] * o.y[l] + p.normal_z[l] * o.z[l];
    const double met = (p.offset[l] - away) / (towards == 0.0 ? 1e-300 : towards);
    t[l] = met > 0.0 ? met : kNone;
  }
}

/// Where rays meet the plane of one face, with its normal in the reference frame.
SENSOR_RT_MULTIVERSION
void meet_plane(const FacePlane& plane, const LaneTransform& __restrict transform, const Lanes3& __restrict d,
                PacketHits& __restrict hits) {
  const double(*r)[kLanes] = transform.rotation;
  const Lanes3& o = transform.origin;
  const double nx = plane.normal[0];
  const double ny = plane.normal[1];
  const double nz = plane.normal[2];
  for (int l = 0; l < kLanes; ++l) {
    const double towards = nx * d.x[l] + ny * d.y[l] + nz * d.z[l];
    const double away = nx * o.x[l] + ny * o.y[l] + nz * o.z[l];
    hits.t[l] = (plane.offset - away) / (towards == 0.0 ? 1e-300 : towards);
    hits.normal.x[l] = r[0][l] * nx + r[3][l] * ny + r[6][l] * nz;
    hits.normal.y[l] = r[1][l] * nx + r[4][l] * ny + r[7][l] * nz;
    hits.normal.z[l] = r[2][l] * nx + r[5][l] * ny + r[8][l] * nz;
  }
}

/// The same for a patch in one plane. False when a ray runs away from it.
bool meet_single_plane(const FacePlane& plane, const Patch& patch, const LaneTransform& transform,
                       const Lanes3& direction, PacketHits& hits) {
  meet_plane(plane, transform, direction, hits);
  double nearest = kNone;
  for (int l = 0; l < kLanes; ++l) {
    nearest = hits.t[l] < nearest ? hits.t[l] : nearest;
    hits.shape[l] = patch.shape;
    hits.face[l] = patch.face[0];
  }
  return nearest > 0.0;
}

/// Sets which[lane] to `number` where the ray's line passes through the triangle (corners as rows).
SENSOR_RT_MULTIVERSION
void pass_through(const double* __restrict c, double number, const Lanes3& __restrict o,
                  const Lanes3& __restrict d, double* __restrict which) {
  for (int l = 0; l < kLanes; ++l) {
    const double ax = c[0] - o.x[l];
    const double ay = c[1] - o.y[l];
    const double az = c[2] - o.z[l];
    const double bx = c[3] - o.x[l];
    const double by = c[4] - o.y[l];
    const double bz = c[5] - o.z[l];
    const double cx = c[6] - o.x[l];
    const double cy = c[7] - o.y[l];
    const double cz = c[8] - o.z[l];
    // Six times the volumes spanned by the ray and each edge: of one sign inside.
    const double ab =
        d.x[l] * (ay * bz - az * by) + d.y[l] * (az * bx - ax * bz) + d.z[l] * (ax * by - ay * bx);
    const double bc =
        d.x[l] * (by * cz - bz * cy) + d.y[l] * (bz * cx - bx * cz) + d.z[l] * (bx * cy - by * cx);
    const double ca =
        d.x[l] * (cy * az - cz * ay) + d.y[l] * (cz * ax - cx * az) + d.z[l] * (cx * ay - cy * ax);
    const bool inside = ((ab >= 0.0) & (bc >= 0.0) & (ca >= 0.0)) | ((ab <= 0.0) & (bc <= 0.0) & (ca <= 0.0));
    which[l] = inside ? number : which[l];
  }
}

/// Turns the normals into the reference frame where the candidate is nearer; says where in `nearer` (1 or 0).
SENSOR_RT_MULTIVERSION
void keep_nearer(const double (*r)[kLanes], const Candidates& __restrict found, PacketHits& __restrict hits,
                 double* __restrict nearer) {
  for (int l = 0; l < kLanes; ++l) {
    const double old_t = hits.t[l];
    const double old_x = hits.normal.x[l];
    const double old_y = hits.normal.y[l];
    const double old_z = hits.normal.z[l];
    const double nx = found.normal.x[l];
    const double ny = found.normal.y[l];
    const double nz = found.normal.z[l];
    const double x = r[0][l] * nx + r[3][l] * ny + r[6][l] * nz;
    const double y = r[1][l] * nx + r[4][l] * ny + r[7][l] * nz;
    const double z = r[2][l] * nx + r[5][l] * ny + r[8][l] * nz;
    const double t = found.t[l];
    const bool take = t < old_t;
    hits.t[l] = take ? t : old_t;
    hits.normal.x[l] = take ? x : old_x;
    hits.normal.y[l] = take ? y : old_y;
    hits.normal.z[l] = take ? z : old_z;
    nearer[l] = take ? 1.0 : 0.0;
  }
}

/// False when no ray meets the mesh.
bool find_faces(const Shape& shape, const Lanes3& origin, const Lanes3& direction, const int* valid,
                const PacketHits& hits, Candidates& found) {
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
    const FacePlane& plane = shape.planes[found.face[l]];
    planes.normal_x[l] = plane.normal[0];
    planes.normal_y[l] = plane.normal[1];
    planes.normal_z[l] = plane.normal[2];
    planes.offset[l] = plane.offset;
    found.normal.x[l] = plane.normal[0];
    found.normal.y[l] = plane.normal[1];
    found.normal.z[l] = plane.normal[2];
  }
  if (!any) return false;
  meet_planes(planes, origin, direction, rays.ray.tfar, found.t);
  for (int l = 0; l < kLanes; ++l) {
    if (valid[l] == 0 || rays.hit.geomID[l] == RTC_INVALID_GEOMETRY_ID) found.t[l] = kNone;
  }
  return true;
}

/// Which face of the patch each ray meets, and where. False when one meets none.
bool choose_faces(const Shape& shape, const Patch& patch, const Lanes3& origin, const Lanes3& direction,
                  const int* valid, Candidates& found) {
  alignas(64) double which[kLanes];
  std::fill(which, which + kLanes, patch.count == 1 ? 0.0 : -1.0);
  for (int k = 0; k < patch.count && patch.count > 1; ++k) {
    double corners[9];
    for (std::size_t i = 0; i < 9; ++i) {
      const std::uint32_t vertex = shape.faces[3 * std::size_t{patch.face[k]} + i / 3];
      corners[i] = static_cast<double>(shape.vertices[3 * std::size_t{vertex} + i % 3]);
    }
    pass_through(corners, k, origin, direction, which);
  }
  LanePlanes planes;
  bool all = true;
  for (int l = 0; l < kLanes; ++l) {
    all = all && (valid[l] == 0 || which[l] >= 0.0);
    found.face[l] = patch.face[which[l] >= 0.0 ? static_cast<int>(which[l]) : 0];
    const FacePlane& plane = shape.planes[found.face[l]];
    planes.normal_x[l] = found.normal.x[l] = plane.normal[0];
    planes.normal_y[l] = found.normal.y[l] = plane.normal[1];
    planes.normal_z[l] = found.normal.z[l] = plane.normal[2];
    planes.offset[l] = plane.offset;
  }
  if (all) meet_planes_ahead(planes, origin, direction, found.t);
  return all;
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
    if (!find_faces(shape, transform.origin, local, valid, hits, found)) return;
  } else {
    intersect_primitive(shape, transform.origin, local, found.t, found.normal);
    for (int l = 0; l < kLanes; ++l) {
      if (valid[l] == 0) found.t[l] = kNone;
      found.face[l] = 0;
    }
  }
  alignas(64) double nearer[kLanes];
  keep_nearer(transform.rotation, found, hits, nearer);
  for (int l = 0; l < kLanes; ++l) {
    hits.shape[l] = nearer[l] > 0.0 ? index : hits.shape[l];
    hits.face[l] = nearer[l] > 0.0 ? found.face[l] : hits.face[l];
  }
}

bool meet_patch(const Shape& shape, const Patch& patch, const LaneTransform& transform,
                const Lanes3& direction, const int* valid, PacketHits& hits) {
  Lanes3 local;
  to_shape_frame(transform.rotation, direction, local);
  const bool full = std::all_of(valid, valid + kLanes, [](int lane) { return lane != 0; });
  const bool is_mesh = shape.kind == ShapeKind::kMesh;
  const auto meet_all = [&](const FacePlane& plane) {
    return meet_single_plane(plane, patch, transform, local, hits);
  };
  if (is_mesh && full && patch.count <= 1) {
    return meet_all(patch.count == 0 ? patch.plane : shape.planes[patch.face[0]]);
  }
  if (patch.count == 0) return false;
  Candidates found;
  if (is_mesh) {
    if (!choose_faces(shape, patch, transform.origin, local, valid, found)) {
      return patch.is_flat && full && meet_all(patch.plane);
    }
  } else {
    intersect_primitive(shape, transform.origin, local, found.t, found.normal);
    std::fill(found.face, found.face + kLanes, 0);
  }
  bool all = true;
  for (int l = 0; l < kLanes; ++l) {
    if (valid[l] == 0) found.t[l] = kNone;
    all = all && (valid[l] == 0 || found.t[l] < kNone);
  }
  clear_hits(hits, kNone);
  alignas(64) double nearer[kLanes];
  keep_nearer(transform.rotation, found, hits, nearer);
  for (int l = 0; l < kLanes; ++l) {
    hits.shape[l] = valid[l] != 0 ? patch.shape : -1;
    hits.face[l] = found.face[l];
  }
  return all;
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
