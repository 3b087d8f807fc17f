#include "sensor_rt/tracing/patch_trace.h"

#include <algorithm>

#include "sensor_rt/tracing/lane_planes.h"
#include "sensor_rt/tracing/primitive.h"
#include "sensor_rt/tracing/trace.h"

namespace sensor_rt {
namespace {

/// Intersects rays with a planar patch. False when a ray is parallel to it or points away.
bool intersect_single_plane(const FacePlane& plane, const Patch& patch, const LaneTransform& transform,
                            const Lanes3& direction, PacketHits& hits) {
  intersect_plane(plane, transform, direction, hits);
  double nearest = kNoHit;
  for (int l = 0; l < kLanes; ++l) {
    nearest = hits.t[l] < nearest ? hits.t[l] : nearest;
    hits.shape[l] = patch.shape;
    hits.face[l] = patch.face[0];
  }
  return nearest > 0.0;
}

/// Finds the face of the patch that each ray hits, and the hit. False when a ray misses all faces.
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
  bool all = true;
  for (int l = 0; l < kLanes; ++l) {
    all = all && (valid[l] == 0 || which[l] >= 0.0);
    found.face[l] = patch.face[which[l] >= 0.0 ? static_cast<int>(which[l]) : 0];
  }
  LanePlanes planes;
  look_up(shape.planes, found, planes);
  if (all) intersect_planes_ahead(planes, origin, direction, found.t);
  return all;
}

}  // namespace

bool intersect_patch(const Shape& shape, const Patch& patch, const LaneTransform& transform,
                     const Lanes3& direction, const int* valid, PacketHits& hits) {
  Lanes3 local;
  to_shape_frame(transform.rotation, direction, local);
  const bool full = std::all_of(valid, valid + kLanes, [](int lane) { return lane != 0; });
  const bool is_mesh = shape.kind == ShapeKind::kMesh;
  const auto intersect_all = [&](const FacePlane& plane) {
    return intersect_single_plane(plane, patch, transform, local, hits);
  };
  if (is_mesh && full && patch.count <= 1) {
    return intersect_all(patch.count == 0 ? patch.plane : shape.planes[patch.face[0]]);
  }
  if (patch.count == 0) return false;
  Candidates found;
  if (is_mesh) {
    if (!choose_faces(shape, patch, transform.origin, local, valid, found)) {
      return patch.is_flat && full && intersect_all(patch.plane);
    }
  } else {
    intersect_primitive(shape, transform.origin, local, found.t, found.normal);
    std::fill(found.face, found.face + kLanes, 0);
  }
  bool all = true;
  for (int l = 0; l < kLanes; ++l) {
    if (valid[l] == 0) found.t[l] = kNoHit;
    all = all && (valid[l] == 0 || found.t[l] < kNoHit);
  }
  clear_hits(hits, kNoHit);
  alignas(64) double nearer[kLanes];
  keep_nearer(transform.rotation, found, hits, nearer);
  for (int l = 0; l < kLanes; ++l) {
    hits.shape[l] = valid[l] != 0 ? patch.shape : -1;
    hits.face[l] = found.face[l];
  }
  return all;
}

}  // namespace sensor_rt
