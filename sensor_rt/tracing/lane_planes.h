// Sixteen rays against planes and triangles in double precision, in the frame of a shape.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "sensor_rt/geometry/rigid3.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// t of rays that meet nothing.
constexpr double kNoHit = std::numeric_limits<double>::infinity();

/// Planes of faces, one per ray.
struct alignas(64) LanePlanes {
  double normal_x[kLanes];
  double normal_y[kLanes];
  double normal_z[kLanes];
  double offset[kLanes];
};

/// Candidate hits of one shape; t is infinite where there is none.
struct Candidates {
  alignas(64) double t[kLanes];
  Lanes3 normal;
  alignas(64) std::uint32_t face[kLanes];
};

/// Points, all by one pose.
void transform(const Rigid3& target_from_source, const Lanes3& source, Lanes3& target);

/// Looks up the planes of found.face, and their normals in `found`.
void look_up(const std::vector<FacePlane>& planes_of_shape, Candidates& found, LanePlanes& planes);

/// Directions of the reference frame in the frame of a shape: `r` are the rotations, row-major.
void to_shape_frame(const double (*r)[kLanes], const Lanes3& d, Lanes3& out);

/// Meets the planes of the faces that were hit again, in double precision.
void meet_planes(const LanePlanes& __restrict p, const Lanes3& __restrict o, const Lanes3& __restrict d,
                 const float* __restrict coarse, double* __restrict t);

/// Where rays meet their planes, infinite behind their origin.
void meet_planes_ahead(const LanePlanes& __restrict p, const Lanes3& __restrict o, const Lanes3& __restrict d,
                       double* __restrict t);

/// Where rays meet the plane of one face, with its normal in the reference frame.
void meet_plane(const FacePlane& plane, const LaneTransform& __restrict transform, const Lanes3& __restrict d,
                PacketHits& __restrict hits);

/// Sets which[lane] to `number` where the ray's line passes through the triangle (corners as rows).
void pass_through(const double* __restrict c, double number, const Lanes3& __restrict o,
                  const Lanes3& __restrict d, double* __restrict which);

/// Turns the normals into the reference frame where the candidate is nearer; says where in `nearer` (1 or 0).
void keep_nearer(const double (*r)[kLanes], const Candidates& __restrict found, PacketHits& __restrict hits,
                 double* __restrict nearer);

}  // namespace sensor_rt
