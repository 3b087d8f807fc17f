// Intersection of sixteen rays with planes and triangles in double precision, in the frame of a shape.
#pragma once

#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// Planes of faces, one per ray.
struct alignas(64) LanePlanes {
  double normal_x[kLanes];
  double normal_y[kLanes];
  double normal_z[kLanes];
  double offset[kLanes];
};

/// Candidate hits with one shape; t is infinite without a hit.
struct Candidates {
  alignas(64) double t[kLanes];
  Lanes3 normal;
  alignas(64) std::uint32_t face[kLanes];
};

/// Transforms points by one pose.
void transform(const Rigid3& target_from_source, const Lanes3& source, Lanes3& target);

/// Gathers the planes of found.face, and their normals into `found`.
void look_up(const std::vector<FacePlane>& planes_of_shape, Candidates& found, LanePlanes& planes);

/// Transforms directions from the reference frame to the frame of a shape: `r` are the rotations, row-major.
void to_shape_frame(const double (*r)[kLanes], const Lanes3& d, Lanes3& out);

/// Recomputes hits with the planes of the hit faces in double precision.
void intersect_planes(const LanePlanes& __restrict p, const Lanes3& __restrict o, const Lanes3& __restrict d,
                      const float* __restrict coarse, double* __restrict t);

/// Keeps the candidates that are nearer, with normals rotated to the reference frame; `nearer` is 1 there,
/// else 0.
void keep_nearer(const double (*r)[kLanes], const Candidates& __restrict found, PacketHits& __restrict hits,
                 double* __restrict nearer);

}  // namespace sensor_rt
