#include "sensor_rt/tracing/lane_planes.h"

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

/// Largest accepted difference (m) between the plane intersection in double precision and Embree's hit:
/// rounding at grazing incidence. Beyond it the ray is nearly parallel to the plane and Embree's hit is more
/// accurate.
constexpr double kMaxCorrection = 1e-4;

/// Rotation given by its columns.
SENSOR_RT_MULTIVERSION
void transform_lanes(const double* __restrict r, const double* __restrict t, const Lanes3& __restrict p,
                     Lanes3& __restrict out) {
  for (int l = 0; l < kLanes; ++l) {
    out.x[l] = r[0] * p.x[l] + r[3] * p.y[l] + r[6] * p.z[l] + t[0];
    out.y[l] = r[1] * p.x[l] + r[4] * p.y[l] + r[7] * p.z[l] + t[1];
    out.z[l] = r[2] * p.x[l] + r[5] * p.y[l] + r[8] * p.z[l] + t[2];
  }
}

}  // namespace

void transform(const Rigid3& target_from_source, const Lanes3& source, Lanes3& target) {
  transform_lanes(target_from_source.rotation.data(), target_from_source.translation.data(), source, target);
}

void look_up(const std::vector<FacePlane>& planes_of_shape, Candidates& found, LanePlanes& planes) {
  for (int l = 0; l < kLanes; ++l) {
    const FacePlane& plane = planes_of_shape[found.face[l]];
    planes.normal_x[l] = found.normal.x[l] = plane.normal[0];
    planes.normal_y[l] = found.normal.y[l] = plane.normal[1];
    planes.normal_z[l] = found.normal.z[l] = plane.normal[2];
    planes.offset[l] = plane.offset;
  }
}

SENSOR_RT_MULTIVERSION
void to_shape_frame(const double (*r)[kLanes], const Lanes3& d, Lanes3& out) {
  for (int l = 0; l < kLanes; ++l) {
    out.x[l] = r[0][l] * d.x[l] + r[1][l] * d.y[l] + r[2][l] * d.z[l];
    out.y[l] = r[3][l] * d.x[l] + r[4][l] * d.y[l] + r[5][l] * d.z[l];
    out.z[l] = r[6][l] * d.x[l] + r[7][l] * d.y[l] + r[8][l] * d.z[l];
  }
}

SENSOR_RT_MULTIVERSION
void intersect_planes(const LanePlanes& __restrict p, const Lanes3& __restrict o, const Lanes3& __restrict d,
                      const float* __restrict coarse, double* __restrict t) {
  for (int l = 0; l < kLanes; ++l) {
    const double towards = p.normal_x[l] * d.x[l] + p.normal_y[l] * d.y[l] + p.normal_z[l] * d.z[l];
    const double away = p.normal_x[l] * o.x[l] + p.normal_y[l] * o.y[l] + p.normal_z[l] * o.z[l];
    const double fine = (p.offset[l] - away) / (towards == 0.0 ? 1e-300 : towards);
    const double length2 = d.x[l] * d.x[l] + d.y[l] * d.y[l] + d.z[l] * d.z[l];
    const double change = fine - static_cast<double>(coarse[l]);
    const double rough = static_cast<double>(coarse[l]);
    const bool credible = (change * change * length2 <= kMaxCorrection * kMaxCorrection) & (fine > 0.0);
    t[l] = credible ? fine : rough;
  }
}

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

}  // namespace sensor_rt
