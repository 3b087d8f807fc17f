#include "sensor_rt/render/pixels/pixel_integrals.h"

#include <cmath>

#include "sensor_rt/geometry/fast_math.h"
#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/render/render_plan.h"

namespace sensor_rt {
namespace {

/// Plane of a lane in the reference frame: n . x = offset.
struct PlaneLane {
  double x, y, z, offset;
};

[[gnu::always_inline]] inline PlaneLane to_reference(const PlanePose& p, const Lanes3& normal,
                                                     const double* offset, int l) {
  const double* r = p.rotation;
  const double nx = normal.x[l];
  const double ny = normal.y[l];
  const double nz = normal.z[l];
  return {r[0] * nx + r[1] * ny + r[2] * nz, r[3] * nx + r[4] * ny + r[5] * nz,
          r[6] * nx + r[7] * ny + r[8] * nz,
          offset[l] - nx * p.translation[0] - ny * p.translation[1] - nz * p.translation[2]};
}

/// Distance from the centre of the sheet at the hit of direction (dx, dy, dz) with a plane, in standard
/// deviations.
[[gnu::always_inline]] inline double across_sheet(const IntegralConstants& c, const PlaneLane& p, double dx,
                                                  double dy, double dz) {
  const double t = (p.offset - p.x * c.viewpoint[0] - p.y * c.viewpoint[1] - p.z * c.viewpoint[2]) /
                   (p.x * dx + p.y * dy + p.z * dz);
  const double depth = c.viewpoint[2] + t * dz - c.laser.sheet.source_z;
  return (c.viewpoint[0] + t * dx) / std::sqrt(c.laser.variance(depth));
}

/// Mean of exp(-q²/2) over intervals of widths with these sums of squares, fourth and sixth powers.
[[gnu::always_inline]] inline double mean_gaussian(double q, double w2, double w4, double w6) {
  const double variance = 1.0 + w2 * (1.0 / 12.0);
  const double z2 = q * q / variance;
  const double inverse2 = 1.0 / variance;
  const double fourth = -w4 * (1.0 / 120.0) * inverse2 * inverse2;
  const double sixth = w6 * (1.0 / 252.0) * inverse2 * inverse2 * inverse2;
  // Hermite polynomials He4, He6, He8
  const double he4 = (z2 - 6.0) * z2 + 3.0;
  const double he6 = ((z2 - 15.0) * z2 + 45.0) * z2 - 15.0;
  const double he8 = (((z2 - 28.0) * z2 + 210.0) * z2 - 420.0) * z2 + 105.0;
  const double series = 1.0 + fourth * (1.0 / 24.0) * he4 + sixth * (1.0 / 720.0) * he6 +
                        fourth * fourth * (1.0 / 1152.0) * he8;
  const double exponent = -0.5 * z2;
  return exp_negative(exponent > -600.0 ? exponent : -600.0) * series * std::sqrt(inverse2);
}

/// Inverse distances from the viewpoint to two planes, their difference g along a direction.
struct PlanePair {
  PlaneLane a, b;
  double scale_a, scale_b;
};

[[gnu::always_inline]] inline PlanePair pair_up(const IntegralConstants& c, const PlaneLane& a,
                                                const PlaneLane& b) {
  const double* v = c.viewpoint;
  return {a, b, 1.0 / (a.offset - a.x * v[0] - a.y * v[1] - a.z * v[2]),
          1.0 / (b.offset - b.x * v[0] - b.y * v[1] - b.z * v[2])};
}

[[gnu::always_inline]] inline double difference(const PlanePair& p, double dx, double dy, double dz) {
  return (p.b.x * dx + p.b.y * dy + p.b.z * dz) * p.scale_b -
         (p.a.x * dx + p.a.y * dy + p.a.z * dz) * p.scale_a;
}

[[gnu::always_inline]] inline PlaneLane mean_plane(const PlaneLane& a, const PlaneLane& b) {
  return {0.5 * (a.x + b.x), 0.5 * (a.y + b.y), 0.5 * (a.z + b.z), 0.5 * (a.offset + b.offset)};
}

}  // namespace

/// Conditions are combined by & and applied as factors: the loop vectorises only without branches.
SENSOR_RT_MULTIVERSION
void integrate_planes(const IntegralConstants& c, const PlanePose& first, const PlanePose& last,
                      const PixelLanes& __restrict b, LightLanes& __restrict out) {
  constexpr double kMaxWidth2 = 2.25;  // the series then errs by 1e-4 of the peak
  constexpr double kMaxLean = 0.01;    // change of the distance from pixel to pixel
  const double* a = c.axes;
  const LaserEmitter& laser = c.laser;
  for (int l = 0; l < kLanes; ++l) {
    const PlaneLane p = to_reference(first, b.normal, b.offset, l);
    const PlaneLane q = to_reference(last, b.normal, b.offset, l);
    const double dx = a[0] * b.x[l] + a[3] * b.y[l] + a[6];
    const double dy = a[1] * b.x[l] + a[4] * b.y[l] + a[7];
    const double dz = a[2] * b.x[l] + a[5] * b.y[l] + a[8];
    const double at_first = across_sheet(c, p, dx, dy, dz);
    const double at_last = across_sheet(c, q, dx, dy, dz);
    // At mid-exposure:
    const double nx = 0.5 * (p.x + q.x);
    const double ny = 0.5 * (p.y + q.y);
    const double nz = 0.5 * (p.z + q.z);
    const double offset = 0.5 * (p.offset + q.offset);
    const double slope = nx * dx + ny * dy + nz * dz;
    const double inverse = 1.0 / slope;
    const double t = (offset - nx * c.viewpoint[0] - ny * c.viewpoint[1] - nz * c.viewpoint[2]) * inverse;
    const double x = c.viewpoint[0] + t * dx;
    const double y = c.viewpoint[1] + t * dy;
    const double depth = c.viewpoint[2] + t * dz - laser.sheet.source_z;
    const double sigma2 = laser.variance(depth);
    const double inverse_sigma = 1.0 / std::sqrt(sigma2);
    // Derivatives of the ray and of the hit by column (u) and row (v):
    const double ux = a[0] * b.dx_du[l] + a[3] * b.dy_du[l];
    const double uy = a[1] * b.dx_du[l] + a[4] * b.dy_du[l];
    const double uz = a[2] * b.dx_du[l] + a[5] * b.dy_du[l];
    const double vx = a[0] * b.dx_dv[l] + a[3] * b.dy_dv[l];
    const double vy = a[1] * b.dx_dv[l] + a[4] * b.dy_dv[l];
    const double vz = a[2] * b.dx_dv[l] + a[5] * b.dy_dv[l];
    const double lean_u = (nx * ux + ny * uy + nz * uz) * inverse;
    const double lean_v = (nx * vx + ny * vy + nz * vz) * inverse;
    const double widening =
        laser.divergence2 * (depth - laser.waist_depth) * x * inverse_sigma * inverse_sigma;
    const double in_u = t * inverse_sigma * (ux - lean_u * dx - widening * (uz - lean_u * dz));
    const double in_v = t * inverse_sigma * (vx - lean_v * dx - widening * (vz - lean_v * dz));
    const double in_t = c.time_scale * (at_last - at_first);
    const double u2 = in_u * in_u;
    const double v2 = in_v * in_v;
    const double t2 = in_t * in_t;
    const double w2 = u2 + v2 + t2;
    // To first order, a change of the other factors across the pixel and a curvature of the distance shift
    // the Gaussian: by a twelfth of the products of the gradients.
    const double in_fan2 = y * y + depth * depth;
    const double fall = -2.0 * t / in_fan2;  // of 1/radius and of the cosine's 1/distance
    const double fall_u = fall * (y * (uy - lean_u * dy) + depth * (uz - lean_u * dz)) - lean_u;
    const double fall_v = fall * (y * (vy - lean_v * dy) + depth * (vz - lean_v * dz)) - lean_v;
    const double across = x * inverse_sigma + (fall_u * in_u + fall_v * in_v) * (1.0 / 12.0);
    const double mean =
        mean_gaussian(across, w2, u2 * u2 + v2 * v2 + t2 * t2, u2 * u2 * u2 + v2 * v2 * v2 + t2 * t2 * t2);
    const double half_width = 0.5 * (std::abs(in_u) + std::abs(in_v) + std::abs(in_t));
    const double half_y = t * (std::abs(uy) + std::abs(vy) + std::abs(lean_u * dy) + std::abs(lean_v * dy));
    const double half_z = t * (std::abs(uz) + std::abs(vz) + std::abs(lean_u * dz) + std::abs(lean_v * dz));
    const double to_source = -(nx * x + ny * y + nz * depth);
    const double facing = slope > 0.0 ? -to_source : to_source;
    const double in_light = std::abs(across) - half_width <= kSheetReach ? 1.0 : 0.0;
    const bool simple = (w2 <= kMaxWidth2) & (std::abs(lean_u) <= kMaxLean) & (std::abs(lean_v) <= kMaxLean) &
                        (t > 0.0) & (facing > 0.0) & laser.in_fan(std::abs(y) + half_y, depth - half_z);
    out.needs_samples[l] = simple ? 0.0 : 1.0;
    out.irradiance[l] = in_light * mean * laser.peak_irradiance(facing, sigma2, x, y, depth);
    const double slope_of_mean = -across / (1.0 + w2 * (1.0 / 12.0));
    out.per_distance[l] = slope_of_mean * inverse_sigma * (dx - widening * dz);
    out.per_change[l] = slope_of_mean * (1.0 / 12.0);
    out.change_of_direction.x[l] = in_u * ux + in_v * vx;
    out.change_of_direction.y[l] = in_u * uy + in_v * vy;
    out.change_of_direction.z[l] = in_u * uz + in_v * vz;
    const double lean = in_u * lean_u + in_v * lean_v;
    out.change_of_point.x[l] = t * (out.change_of_direction.x[l] - lean * dx);
    out.change_of_point.y[l] = t * (out.change_of_direction.y[l] - lean * dy);
    out.change_of_point.z[l] = t * (out.change_of_direction.z[l] - lean * dz);
    out.distance[l] = t;
    out.direction.x[l] = dx;
    out.direction.y[l] = dy;
    out.direction.z[l] = dz;
    out.normal.x[l] = nx;
    out.normal.y[l] = ny;
    out.normal.z[l] = nz;
    out.from_source.x[l] = x;
    out.from_source.y[l] = y;
    out.from_source.z[l] = depth;
  }
}

SENSOR_RT_MULTIVERSION
void integrate_edges(const IntegralConstants& c, const PlanePose& first, const PlanePose& last,
                     const PixelLanes& __restrict b, LightLanes& __restrict out) {
  constexpr double kMaxCosines = 0.01;      // relative difference of cosines
  constexpr double kMaxBrightening = 0.02;  // relative difference of irradiance by that of distance
  constexpr double kNarrow = 1e-3;          // least width of an interval, relative to their sum
  const double* a = c.axes;
  for (int l = 0; l < kLanes; ++l) {
    const PlanePair start = pair_up(c, to_reference(first, b.normal, b.offset, l),
                                    to_reference(first, b.other_normal, b.other_offset, l));
    const PlanePair end = pair_up(c, to_reference(last, b.normal, b.offset, l),
                                  to_reference(last, b.other_normal, b.other_offset, l));
    const PlanePair middle = pair_up(c, mean_plane(start.a, end.a), mean_plane(start.b, end.b));
    const double dx = out.direction.x[l];
    const double dy = out.direction.y[l];
    const double dz = out.direction.z[l];
    // The face is met before the first one's plane where it rises towards the viewpoint, else behind it.
    const double side = middle.scale_a < 0.0 ? b.rise[l] : -b.rise[l];
    const double g = side * difference(middle, dx, dy, dz);
    const double in_u =
        std::abs(difference(middle, a[0] * b.dx_du[l] + a[3] * b.dy_du[l],
                            a[1] * b.dx_du[l] + a[4] * b.dy_du[l], a[2] * b.dx_du[l] + a[5] * b.dy_du[l]));
    const double in_v =
        std::abs(difference(middle, a[0] * b.dx_dv[l] + a[3] * b.dy_dv[l],
                            a[1] * b.dx_dv[l] + a[4] * b.dy_dv[l], a[2] * b.dx_dv[l] + a[5] * b.dy_dv[l]));
    const double in_t = c.time_scale * std::abs(difference(end, dx, dy, dz) - difference(start, dx, dy, dz));
    const double sum = in_u + in_v + in_t + 1e-300;
    const double scale = 1.0 / sum;
    const double u = in_u * scale > kNarrow ? in_u * scale : kNarrow;
    const double v = in_v * scale > kNarrow ? in_v * scale : kNarrow;
    const double w = in_t * scale > kNarrow ? in_t * scale : kNarrow;
    const double raw = g * scale;
    const double low = raw < -1.0 ? -1.0 : raw;
    const double z = low > 1.0 ? 1.0 : low;
    double step = 0.0;
    double ramp = 0.0;
    for (int k = 0; k < 8; ++k) {
      const double su = (k & 1) != 0 ? 0.5 : -0.5;
      const double sv = (k & 2) != 0 ? 0.5 : -0.5;
      const double sw = (k & 4) != 0 ? 0.5 : -0.5;
      const double corner = z + su * u + sv * v + sw * w;
      const double up = corner > 0.0 ? corner : 0.0;
      const double cube = 8.0 * su * sv * sw * up * up * up;
      step += cube;
      ramp += cube * up;
    }
    const double volume = 1.0 / (u * v * w);
    const double share = step * volume * (1.0 / 6.0);
    const double height = ramp * volume * (1.0 / 24.0) * sum;
    const double nx = middle.b.x;
    const double ny = middle.b.y;
    const double nz = middle.b.z;
    const double facing = out.normal.x[l] * out.from_source.x[l] + out.normal.y[l] * out.from_source.y[l] +
                          out.normal.z[l] * out.from_source.z[l];
    const double other = nx * out.from_source.x[l] + ny * out.from_source.y[l] + nz * out.from_source.z[l];
    const double cosines = other / facing;
    const double t = out.distance[l];
    const double per_height = -side * out.per_distance[l] * t * t;
    const bool simple = (b.rise[l] != 0.0) & (std::abs(cosines - 1.0) <= kMaxCosines) &
                        (std::abs(per_height) * sum <= kMaxBrightening);
    out.share[l] = share;
    out.brightening[l] = per_height * height;
    out.cosines[l] = cosines;
    out.is_edge[l] = simple ? 1.0 : 0.0;
    out.other_normal.x[l] = nx;
    out.other_normal.y[l] = ny;
    out.other_normal.z[l] = nz;
  }
}

}  // namespace sensor_rt
